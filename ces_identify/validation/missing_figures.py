"""Why a figure of a recording is missing: the reasons behind the dashes in tables of costs."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ces_identify.validation.cost_interval import MAX_FACTOR, CostInterval
from ces_identify.validation.cycle_noise import CycleNoise
from ces_identify.validation.evaluate import Evaluation

DIVERGED = "no interval and no RMS error (the free run diverged)"
SHORT = f"no interval (too short: it would reach beyond {MAX_FACTOR:g} times the cost)"


def explain_missing(
    evaluations: Sequence[Evaluation],
    intervals: Sequence[CostInterval | None],
    floors: Sequence[CycleNoise | str],
) -> list[str]:
    """Return a line for each reason, with the names of the recordings; intervals and floors are those of `evaluations`.

    The line is such as `no noise floor (the stroke does not repeat): noise, road`, or `...: all recordings`.
    """
    names: dict[str, list[str]] = {}
    for evaluation, interval, floor in zip(evaluations, intervals, floors, strict=True):
        if not math.isfinite(evaluation.cost):
            names.setdefault(DIVERGED, []).append(evaluation.name)
        elif interval is None:
            names.setdefault(SHORT, []).append(evaluation.name)
        if isinstance(floor, str):
            names.setdefault(f"no noise floor ({floor})", []).append(evaluation.name)
    return [f"{reason}: {_join(which, len(evaluations))}" for reason, which in names.items()]


def _join(names: Sequence[str], of: int) -> str:
    """Return the names of recordings, each once; of several that are all, that they are all."""
    return "all recordings" if 1 < of == len(names) else ", ".join(dict.fromkeys(names))
