"""A comparison as tables, each column once for terminal and page, and as a document for other programs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

from ces_identify.comparison.comparison import (
    Comparison,
    ModelResult,
    RecordingCost,
    describe_interval,
    format_signed,
    join,
    p_text,
)
from ces_identify.comparison.pair_results import Difference, PairResult
from ces_identify.validation.cost_table import NONE, interval_text, percent
from ces_identify.validation.evaluate import CostInterval
from ces_report.table import Column, Table

TOO_SHORT = "too short"


def model_table(comparison: Comparison) -> Table[int]:
    """Return a row for each model with what it is."""

    def text(of: Callable[[ModelResult], object | None], form: str = "") -> Callable[[int], str]:
        return lambda i: NONE if (value := of(comparison.models[i])) is None else f"{value:{form}}"

    columns: list[Column[int]] = [
        Column("model", text(lambda m: m.name)),
        Column("size", text(lambda m: None if m.model.model is None else m.model.model.size)),
        Column("µs/tick", text(lambda m: None if m.tick is None else m.tick.median_us, ".1f"), figure=True),
        Column(
            "bound kN", text(lambda m: None if m.force_bound_N is None else m.force_bound_N / 1000, ".4g"), figure=True
        ),
        Column("out %", lambda i: outside_percent(comparison, i, NONE), figure=True),
    ]
    return Table(columns, range(len(comparison.models)), "models")


def outside_percent(comparison: Comparison, model: int, missing: str) -> str:
    """Return the largest share [%] of a recording's ticks with some signal outside the model's envelope."""
    if comparison.models[model].model.model is None:
        return missing
    shares = [max((one.outside_share for one in r.exits[model]), default=0.0) for r in comparison.recordings]
    return f"{100 * max(shares):.1f}"


def recording_table(comparison: Comparison) -> Table[tuple[int, int]]:
    """Return a row for each model (second index) on each recording (first)."""
    recordings, models = comparison.recordings, comparison.models

    def name(row: tuple[int, int]) -> str:
        return f"{recordings[row[0]].name}, {recordings[row[0]].seconds:.1f} s" if row[1] == 0 else ""

    def of_cost(text: Callable[[RecordingCost], str]) -> Callable[[tuple[int, int]], str]:
        return lambda row: text(models[row[1]].costs[row[0]])

    columns: list[Column[tuple[int, int]]] = [
        Column("recording", name),
        Column("model", lambda row: models[row[1]].name),
        Column("use", of_cost(lambda cost: cost.use)),
        Column("J %", of_cost(lambda cost: percent(cost.cost)), figure=True),
        Column("95 %", of_cost(lambda cost: interval_text(cost.interval)), figure=True),
        Column("RMS N", of_cost(lambda c: f"{c.rms_N:.1f}" if math.isfinite(c.rms_N) else NONE), figure=True),
    ]
    rows = [(n, i) for n in range(len(recordings)) for i in range(len(models))]
    return Table(columns, rows, "each recording", group=lambda row: row[0])


def pair_table(comparison: Comparison) -> Table[PairResult]:
    """Return a row for each pair of models with the difference of their costs."""
    models = comparison.models

    def sort_value(value: float | None) -> object:
        return "" if value is None or math.isnan(value) else value

    def better(pair: PairResult) -> str:
        return pair.verdict if pair.better is None else f"{'first' if pair.better == pair.first else 'second'} better"

    pages: list[Column[PairResult]] = [
        Column("First − second", lambda p: f"{models[p.first].name} − {models[p.second].name}"),
        Column("On", lambda p: join(p.pooled.recordings)),
        Column(
            "Difference of J [%]",
            lambda p: difference_text(p.pooled),
            figure=True,
            value=lambda p: sort_value(p.pooled.value),
        ),
        Column("p", lambda p: p_text(p.p_value).replace("-", "–"), figure=True, value=lambda p: sort_value(p.p_value)),
        Column("Verdict", lambda p: p.verdict if p.better is None else f"{models[p.better].name} is better"),
    ]
    if len({pair.pooled.recordings for pair in comparison.pairs}) == 1:
        del pages[1]
    terminals: list[Column[PairResult]] = [
        Column("first", lambda p: models[p.first].name),
        Column("second", lambda p: models[p.second].name),
        Column("J", lambda p: format_signed(p.pooled.value) if math.isfinite(p.pooled.value) else NONE, figure=True),
        Column("interval", lambda p: describe_interval(p.pooled), figure=True),
        Column("p", lambda p: p_text(p.p_value), figure=True),
        Column("verdict", better),
    ]
    columns = [replace(c, page_only=True) for c in pages] + [replace(c, terminal_only=True) for c in terminals]
    return Table(columns, comparison.pairs, "differences of J, first minus second")


def difference_text(one: Difference) -> str:
    """Return a difference with its interval, or why there is none."""
    if not math.isfinite(one.value):
        return "diverged"
    return f"{format_signed(one.value)} ({describe_interval(one, TOO_SHORT)})"


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
        "models": [_model_facts(i, model, comparison) for i, model in enumerate(comparison.models)],
        "pairs": [_pair_facts(pair, names) for pair in comparison.pairs],
        "notes": comparison.notes(),
        "machine": comparison.machine,
    }


def _model_facts(i: int, result: ModelResult, comparison: Comparison) -> dict[str, Any]:
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
                "ci95_percent": _ends(cost.interval),
                "rms_N": _finite(cost.rms_N),
                "outside_envelope": [asdict(one) for one in recording.exits[i]],
            }
            for cost, recording in zip(result.costs, comparison.recordings, strict=True)
        ],
        "pooled": {"J_percent": _finite(result.pooled), "ci95_percent": _ends(result.pooled_interval)},
        "tick": None if result.tick is None else asdict(result.tick),
        "force_bound_N": result.force_bound_N,
    }


def _pair_facts(pair: PairResult, names: list[str]) -> dict[str, Any]:
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


def _ends(interval: CostInterval | None) -> list[float] | None:
    return None if interval is None else [interval.low, interval.high]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
