"""A comparison as plain values for JSON, without its time series; numbers that are not finite become null."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from ces_identify.comparison.comparison import Comparison, ModelResult
from ces_identify.comparison.pair_results import Difference, PairResult
from ces_identify.validation.cost_interval import CostInterval


def comparison_document(comparison: Comparison) -> dict[str, Any]:
    """Return the comparison as mappings, lists, texts and numbers."""
    names = [model.name for model in comparison.models]
    return {
        "part": list(comparison.part),
        "recordings": [
            {"name": r.name, "source": r.source, "sha256": r.sha256, "scored_s": round(r.seconds, 3)}
            for r in comparison.recordings
        ],
        "test_recordings": list(comparison.test_names),
        "models": [_model(i, model, comparison) for i, model in enumerate(comparison.models)],
        "pairs": [_pair(pair, names) for pair in comparison.pairs],
        "notes": comparison.notes(),
        "machine": comparison.machine,
    }


def _model(i: int, result: ModelResult, comparison: Comparison) -> dict[str, Any]:
    model = result.model.model
    return {
        "name": result.name,
        "source": result.model.source,
        "structure": None if model is None else model.structure,
        "size": None if model is None else model.size,
        "rate_Hz": None if model is None else model.sampling.rate_Hz,
        "costs": [
            {
                "recording": cost.recording,
                "use": cost.use,
                "J_percent": _finite(cost.cost),
                "ci95_percent": _interval(cost.interval),
                "rms_N": _finite(cost.rms_N),
                "outside_envelope": [asdict(one) for one in recording.exits[i]],
            }
            for cost, recording in zip(result.costs, comparison.recordings, strict=True)
        ],
        "pooled": {"J_percent": _finite(result.pooled), "ci95_percent": _interval(result.pooled_interval)},
        "tick": None if result.tick is None else asdict(result.tick),
        "force_bound_N": result.force_bound_N,
    }


def _pair(pair: PairResult, names: list[str]) -> dict[str, Any]:
    return {
        "first": names[pair.first],
        "second": names[pair.second],
        "verdict": pair.verdict,
        "better": None if pair.better is None else names[pair.better],
        "p_value": pair.p_value,
        "pooled": _difference(pair.pooled),
        "each": [_difference(one) for one in pair.each],
        "text": pair.text,
    }


def _difference(one: Difference) -> dict[str, Any]:
    return {
        "recordings": list(one.recordings),
        "first_minus_second_percent": _finite(one.value),
        "interval_percent": None if one.low is None else [one.low, one.high],
    }


def _interval(interval: CostInterval | None) -> list[float] | None:
    return None if interval is None else [interval.low, interval.high]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
