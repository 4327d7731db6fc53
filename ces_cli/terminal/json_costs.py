"""The rows of the tables of costs for --json: the same numbers, not rounded."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ces_cli.terminal.tables import find_weighted_cost
from ces_identify.folds import CrossValidation
from ces_identify.preparation.weighting import EQUAL, Weighting
from ces_identify.validation.cost_interval import CostInterval, cost_interval, pooled_cost
from ces_identify.validation.cycle_noise import CycleNoise, cycle_noise
from ces_identify.validation.evaluate import VALIDATION, Evaluation
from ces_observer.model import Model


def cost_rows(evaluations: Sequence[Evaluation], weighting: Weighting = EQUAL) -> list[dict[str, Any]]:
    """Return an object for each evaluation.

    Its keys are `recording`, `role`, `scored_s`, `J_percent` and `ci95_percent` (both null if the run diverged),
    `floor_percent` (null where cycles do not repeat), `weighted_J_percent` (null without weights), `rms_N`,
    `outside_envelope` (share) and `inside_band` (share; null without a band).
    """
    return [_cost_row(evaluation, weighting) for evaluation in evaluations]


def _cost_row(e: Evaluation, weighting: Weighting) -> dict[str, Any]:
    floor = cycle_noise(e.series)
    return {
        "recording": e.name,
        "role": e.role,
        "scored_s": float(e.series.scored.sum()) / e.series.rate_Hz,
        "J_percent": e.cost,
        "ci95_percent": interval_as_list(cost_interval([e])),
        "floor_percent": floor.floor if isinstance(floor, CycleNoise) else None,
        "weighted_J_percent": find_weighted_cost(e, weighting) if weighting else None,
        "rms_N": e.rms_N,
        "outside_envelope": e.clamped_share,
        "inside_band": e.coverage,
    }


def held_out_row(evaluations: Sequence[Evaluation]) -> dict[str, Any] | None:
    """Return J and its interval over all recordings for validation together; None for fewer than two."""
    held_out = [e for e in evaluations if e.role == VALIDATION and math.isfinite(e.cost)]
    if len(held_out) < 2:
        return None
    return {"J_percent": pooled_cost(held_out), "ci95_percent": interval_as_list(cost_interval(held_out))}


def fold_rows(folds: CrossValidation | None) -> dict[str, Any] | None:
    """Return the held-out costs of a cross-validation; None without one."""
    if folds is None:
        return None
    rows = [
        {
            "recording": row.recording,
            "fold": row.fold,
            "J_percent": row.cost,
            "ci95_percent": interval_as_list(row.interval),
            "model": row.model,
        }
        for row in folds.rows
    ]
    return {"rows": rows, "mean_J_percent": folds.mean, "spread_J_percent": folds.spread}


def model_facts(model: Model) -> dict[str, Any]:
    """Return what a document says of a model: size, rate, whether its stability is proved, and the band's level."""
    return {
        "size": model.size,
        "rate_Hz": model.sampling.rate_Hz,
        "proved_stable": model.certificate is not None,
        "band_level": None if model.band is None else model.band.level,
    }


def interval_as_list(interval: CostInterval | None) -> list[float] | None:
    """Return an interval as [low, high]; None without one."""
    return None if interval is None else [interval.low, interval.high]
