"""A comparison as tables for the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator

from rich.table import Table

from ces_cli.terminal.tables import NONE, interval_text, percent
from ces_cli.terminal.terminal import make_table
from ces_identify.comparison.comparison import Comparison, ModelResult, join
from ces_identify.comparison.conclusions import best_model, format_signed, headline, p_text
from ces_identify.comparison.pair_results import SHORT, Difference, PairResult

LOWEST = "lowest"
MAX_PAIRS = 6  # that the terminal shows


def cost_table(comparison: Comparison) -> Table:
    """Return a row for each model, lowest cost first: its cost, and how much more that is than the lowest."""
    tests = comparison.test_names
    title = f"cost J over {join(tests)}" if tests else "cost J over all (not a test)"
    table = make_table(title, ("model",), ("J %", "95 %", "above the lowest"))
    best = best_model(comparison)
    for i in sorted(range(len(comparison.models)), key=lambda i: comparison.models[i].pooled):
        model = comparison.models[i]
        above = LOWEST if i == best else _above(comparison, best, i)
        table.add_row(model.name, percent(model.pooled), interval_text(model.pooled_interval), above)
    return table


def model_table(comparison: Comparison) -> Table:
    """Return a row for each model with what it is."""
    table = make_table("models", ("model", "size"), ("µs/tick", "bound kN", "out %"))
    for i, model in enumerate(comparison.models):
        table.add_row(model.name, _size(model), _tick(model), _bound(model), _outside(comparison, i))
    return table


def recording_table(comparison: Comparison) -> Table:
    """Return a row for each model on each recording."""
    table = make_table("each recording", ("recording", "model", "use"), ("J %", "95 %", "RMS N"))
    for n, recording in enumerate(comparison.recordings):
        for i, model in enumerate(comparison.models):
            cost = model.costs[n]
            name = f"{recording.name}, {recording.seconds:.1f} s" if i == 0 else ""
            rms = f"{cost.rms_N:.1f}" if math.isfinite(cost.rms_N) else NONE
            table.add_row(name, model.name, cost.use, percent(cost.cost), interval_text(cost.interval), rms)
        table.add_section()
    return table


def pair_table(comparison: Comparison) -> Table:
    """Return a row for each pair of models with the difference of their costs."""
    table = make_table("differences of J, first minus second", ("first", "second"), ("J", "interval", "p"))
    table.add_column("verdict", overflow="fold")
    for pair in comparison.pairs:
        names = [comparison.models[i].name for i in (pair.first, pair.second)]
        difference = pair.pooled
        table.add_row(
            *names, _format_signed(difference.value), interval_of(difference), p_text(pair.p_value), _verdict(pair)
        )
    return table


def sentences(comparison: Comparison) -> Iterator[str]:
    """Yield what the differences say, and what to know before believing them."""
    yield headline(comparison)
    if any(math.isfinite(cost.cost) and cost.interval is None for m in comparison.models for cost in m.costs):
        yield f"{NONE}: too short for an interval"
    others = [m.name for m in comparison.models if m.model.model is None]
    if others:
        yield f"{NONE} for {join(others)}: no size, time of a tick, bound or envelope, because it is no model file"
    if len(comparison.pairs) > MAX_PAIRS:
        yield f"{len(comparison.pairs)} pairs of models: all differences with --report or --json"
    if any(m.force_bound_N is not None for m in comparison.models):
        yield "bound: |force| for inputs within the model's envelope, proved when it was identified"
    if comparison.machine:
        yield f"µs/tick: the observer's estimator on this machine ({comparison.machine}), models in turns"
    yield from (f"note: {note}" for note in comparison.notes())


def interval_of(difference: Difference) -> str:
    """Return the interval of a difference as text, a dash without one."""
    if difference.low is None or difference.high is None:
        return NONE
    return f"{_format_signed(difference.low)} to {_format_signed(difference.high)}"


def _above(comparison: Comparison, best: int, model: int) -> str:
    """Return how much higher the pooled cost of `model` is than the lowest; a dash if that is not a test."""
    if not comparison.test_names:
        return NONE
    difference = comparison.pair(best, model).minus(best)
    if difference.low is None or difference.high is None:
        return SHORT if math.isfinite(difference.value) else NONE
    return f"{_format_signed(difference.value)} ({interval_of(difference)})"


def _verdict(pair: PairResult) -> str:
    if pair.better is None:
        return pair.verdict
    return "first better" if pair.better == pair.first else "second better"


def _format_signed(value: float) -> str:
    return format_signed(value) if math.isfinite(value) else NONE


def _size(model: ModelResult) -> str:
    return NONE if model.model.model is None else model.model.model.size


def _tick(model: ModelResult) -> str:
    return NONE if model.tick is None else f"{model.tick.median_us:.1f}"


def _bound(model: ModelResult) -> str:
    return NONE if model.force_bound_N is None else f"{model.force_bound_N / 1000:.4g}"


def _outside(comparison: Comparison, i: int) -> str:
    """Return the largest share of a recording's ticks with some signal outside the model's envelope."""
    if comparison.models[i].model.model is None:
        return NONE
    shares = [max((one.outside_share for one in r.exits[i]), default=0.0) for r in comparison.recordings]
    return f"{100 * max(shares):.1f}"
