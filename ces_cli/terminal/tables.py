"""Tables of costs for the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from rich.table import Table

from ces_cli.terminal.terminal import make_table, print_warning
from ces_identify.folds import CrossValidation
from ces_identify.polynomial.problem import estimation_ticks
from ces_identify.preparation.cost import weighted_cost
from ces_identify.preparation.weighting import EQUAL, Weighting
from ces_identify.validation.cost_interval import CostInterval, cost_interval, pooled_cost
from ces_identify.validation.cycle_noise import CycleNoise, cycle_noise
from ces_identify.validation.evaluate import IDENTIFICATION, VALIDATION, Evaluation
from ces_identify.validation.missing_figures import explain_missing
from ces_observer.model import Model

NONE = "-"


def cost_table(
    evaluations: Sequence[Evaluation], title: str, weighting: Weighting = EQUAL, exact: bool = True
) -> Table:
    """Return a table with a row for each evaluation, and one for all held-out recordings together.

    Columns: use of the scored seconds, J and its 95 % interval, the noise floor of J where cycles repeat, the weighted
    J if there are weights, the RMS error, the share of ticks outside the envelope, and that of measured forces inside
    the band, if the model has one. With `exact` the evaluations
    are those of the identification itself, whose seconds of estimation and selection are known.
    """
    floors = [cycle_noise(e.series) for e in evaluations]
    has_floor = any(isinstance(floor, CycleNoise) for floor in floors)
    has_band = any(e.coverage is not None for e in evaluations)
    headings = ("J %", "95 %", *(["floor"] if has_floor else []), *(["weighted"] if weighting else []))
    table = make_table(
        title, ("recording", "used for"), (*headings, "RMS N", "out %", *(["band %"] if has_band else []))
    )
    table.columns[0].min_width = min(14, max(len(e.name) for e in evaluations))
    table.columns[1].no_wrap = True
    for e, floor in zip(evaluations, floors, strict=True):
        cells = [e.name, describe_use(e, exact), percent(e.cost), interval_text(cost_interval([e]))]
        cells += [f"{floor.floor:.2f}" if isinstance(floor, CycleNoise) else NONE] if has_floor else []
        cells += [_format_weighted_cost(e, weighting)] if weighting else []
        cells += [_format_newtons(e.rms_N), f"{100 * e.clamped_share:.1f}"]
        table.add_row(*cells, *([NONE if e.coverage is None else f"{100 * e.coverage:.1f}"] if has_band else []))
    held_out = [e for e in evaluations if e.role == VALIDATION and math.isfinite(e.cost)]
    if len(held_out) > 1:
        table.add_section()
        costs = (percent(pooled_cost(held_out)), interval_text(cost_interval(held_out)))
        table.add_row("all held out", _test(held_out), *costs)
    return table


def print_missing(evaluations: Sequence[Evaluation]) -> None:
    """Print why figures of the cost table are missing."""
    floors = [cycle_noise(e.series) for e in evaluations]
    if not any(isinstance(floor, CycleNoise) for floor in floors):  # then there is no such column
        floors = [CycleNoise(0.0, 0, 0.0, 0.0)] * len(floors)
    for line in explain_missing(evaluations, [cost_interval([e]) for e in evaluations], floors):
        print(f"{NONE}: {line}")


def print_outside(evaluations: Sequence[Evaluation]) -> None:
    """Print a warning for each recording that leaves the model's envelope, with the ranges of its signals."""
    for text in filter(None, (e.outside_text for e in evaluations)):
        print_warning(text)


def print_band(model: Model, evaluations: Sequence[Evaluation]) -> None:
    """Print what the column `band %` shows, if the model has a band."""
    if model.band is None:
        return
    widths = [float(np.mean(e.half_width[e.series.scored])) for e in evaluations if e.half_width is not None]
    print(
        f"band: meant to hold {100 * model.band.level:.0f} % of the measured forces, sensor noise included; column "
        f"'band %' is the share it holds; mean half-width {describe_range(min(widths), max(widths))} N"
    )


def describe_range(low: float, high: float) -> str:
    """Return two numbers without decimals as a range, or as one number if they read the same."""
    return f"{low:.0f}" if f"{low:.0f}" == f"{high:.0f}" else f"{low:.0f} to {high:.0f}"


def fold_table(result: CrossValidation) -> Table:
    """Return a table with a row for each held-out recording, and the mean and spread of J."""
    table = make_table("each recording held out once", ("recording",), ("fold", "J %", "95 %", "model"))
    for row in result.rows:
        table.add_row(row.recording, str(row.fold), percent(row.cost), interval_text(row.interval), row.model)
    table.add_section()
    spread = f"spread {result.spread:.2f}" if math.isfinite(result.spread) else NONE
    table.add_row("mean", "", percent(result.mean), spread, "")
    return table


def describe_use(evaluation: Evaluation, exact: bool = True) -> str:
    """Return the use of an evaluation's scored seconds."""
    series = evaluation.series
    if evaluation.role != IDENTIFICATION:
        return _test([evaluation])
    if not exact:
        return "identified on"
    estimation = float((series.scored & estimation_ticks(series)).sum()) / series.rate_Hz
    total = float(series.scored.sum()) / series.rate_Hz
    return f"estimation {estimation:.1f} s\nselection {total - estimation:.1f} s"


def percent(cost: float) -> str:
    """Return a cost J as text; a run that left its force envelope has none."""
    return f"{cost:.2f}" if math.isfinite(cost) else "diverged"


def interval_text(interval: CostInterval | None) -> str:
    """Return an interval as text, a dash if there is none."""
    return NONE if interval is None else f"{interval.low:.2f}-{interval.high:.2f}"


def _format_newtons(value: float) -> str:
    """Return a force as text; a run that left its force envelope has none."""
    return NONE if not math.isfinite(value) else f"{value:.1f}" if value < 1e4 else f"{value:.0f}"


def _test(evaluations: Sequence[Evaluation]) -> str:
    return f"test {sum(float(e.series.scored.sum()) / e.series.rate_Hz for e in evaluations):.1f} s"


def _format_weighted_cost(evaluation: Evaluation, weighting: Weighting) -> str:
    value = find_weighted_cost(evaluation, weighting)
    return NONE if math.isnan(value) else percent(value)


def find_weighted_cost(evaluation: Evaluation, weighting: Weighting) -> float:
    """Return the weighted J [%] of an evaluation, NaN where no weighted tick is scored."""
    scored = evaluation.series.scored
    weights = weighting.tick_weights(evaluation.series)[scored]
    return weighted_cost(evaluation.series.force[scored], evaluation.run.force[scored], weights)
