"""An explanation of a gap: effects with their parameters, what they leave of it, and how probable they are."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ces_data.reading import import_pandas
from ces_gap.effects.effect import Composition, Setting
from ces_gap.effects.refitted import NetworkPart
from ces_gap.inference.fit import Estimate, Interval
from ces_report.table import PrintedResult


@dataclass(frozen=True, repr=False)
class Explanation(PrintedResult):
    """One or several effects, with gap and shrink on held-out recordings, without measurement noise."""

    effects: tuple[str, ...]
    forms: tuple[str, ...]
    composition: Composition
    estimates: tuple[tuple[Estimate, ...], ...]  # by effect
    gap_after_N: float
    shrink: float
    shrink_ci95: Interval
    gain: float = 0.0  # cross-fitted share of the gap's energy explained on the fitted recordings
    gain_error: float = 0.0
    probability: float = 0.0  # that it is a cause
    without_N: tuple[float, ...] = ()  # the gap left without each of several effects, the others refitted

    def to_frame(self) -> Any:
        """Return the parameters as a DataFrame, in SI units, with their 95 % intervals.

        The quantities of a network's part have none; their units are in their names.
        """
        rows = [
            {
                "effect": effect,
                "parameter": e.name,
                "default": e.default,
                "value": e.value,
                "low": e.ci95[0],
                "high": e.ci95[1],
                "at_bound": e.at_bound,
                "drifts": e.drifts,
            }
            for effect, setting, estimates in zip(self.effects, self.composition.settings, self.estimates, strict=True)
            for e in (*_read_quantities(setting), *estimates)
        ]
        return import_pandas().DataFrame(rows)


def _read_quantities(setting: Setting) -> list[Estimate]:
    moved = setting.effect.read_quantities() if isinstance(setting.effect, NetworkPart) else {}
    return [Estimate(name, value, (math.nan, math.nan)) for name, value in moved.items()]


def share_probabilities(
    odds: Mapping[str, float], causes: Sequence[Explanation], together: Explanation
) -> tuple[tuple[Explanation, ...], Explanation]:
    """Return the causes, most probable first, and what acts together, each with the probability that it is a cause.

    The effects that act together have the sum of theirs: each is a cause if all are.
    """
    total = sum(odds.get(name, 0.0) for name in together.effects)
    known = {**odds, **dict.fromkeys(together.effects, total)}
    shared = [replace(c, probability=known[c.effects[0]]) for c in causes]
    return tuple(sorted(shared, key=lambda c: -c.probability)), replace(together, probability=total)
