"""The table of costs of evaluations, and how its figures read."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ces_identify.polynomial.problem import estimation_ticks
from ces_identify.prepare.cost import EQUAL, Weighting
from ces_identify.validation.evaluate import IDENTIFICATION, CostInterval, Evaluation
from ces_report.table import Column, Table

NONE = "-"


def cost_table(
    evaluations: Sequence[Evaluation], title: str = "", weighting: Weighting = EQUAL, exact: bool = True
) -> Table[Evaluation]:
    """Return a table with a row for each evaluation.

    Columns: use of the scored seconds, J and its 95 % interval, the noise floor of J where cycles repeat, the weighted
    J if there are weights, the RMS error, the share of ticks outside the envelope, and that of measured forces inside
    the band, if the model has one. With `exact` the evaluations are those of the identification itself, whose seconds
    of estimation and selection are known.
    """
    columns: list[Column[Evaluation]] = [
        Column("Recording", lambda e: e.name, short="recording"),
        Column("Used for", lambda e: _describe_use(e, exact), short="used for"),
        Column("J [%]", lambda e: percent(e.cost), figure=True, short="J %"),
        Column("95 % interval [%]", lambda e: interval_text(e.interval), figure=True, short="95 %"),
    ]
    if any(e.floor is not None for e in evaluations):
        columns.append(Column("Noise floor [%]", lambda e: _format(e.floor, 2), figure=True, short="floor"))
    if weighting:
        columns.append(
            Column("Weighted J [%]", lambda e: _format_weighted_cost(e, weighting), figure=True, short="weighted")
        )
    columns.append(Column("RMS error [N]", lambda e: _format_newtons(e.rms_N), figure=True, short="RMS N"))
    columns.append(
        Column("Outside envelope [%]", lambda e: _format(100 * e.clamped_share, 1), figure=True, short="out %")
    )
    if any(e.coverage is not None for e in evaluations):
        inside = Column[Evaluation](
            "Inside band [%]",
            lambda e: NONE if e.coverage is None else _format(100 * e.coverage, 1),
            figure=True,
            short="band %",
        )
        columns.append(inside)
    return Table(columns, evaluations, title)


class Evaluations(list[Evaluation]):
    """Evaluations that print themselves as a table."""

    def __repr__(self) -> str:
        return str(cost_table(self, exact=False)) if self else "no evaluation"

    def _repr_html_(self) -> str:
        return str(cost_table(self, exact=False).to_html())


def percent(cost: float) -> str:
    """Return a cost J as text; a run that left its force envelope has none."""
    return f"{cost:.2f}" if math.isfinite(cost) else "diverged"


def interval_text(interval: CostInterval | None) -> str:
    """Return an interval as text, a dash if there is none."""
    return NONE if interval is None else f"{interval.low:.2f}-{interval.high:.2f}"


def _describe_use(e: Evaluation, exact: bool) -> str:
    """Return the use of an evaluation's scored seconds."""
    if e.role != IDENTIFICATION:
        return f"test {e.scored_s:.1f} s"
    if not exact:
        return "identified on"
    estimation = float((e.series.scored & estimation_ticks(e.series)).sum()) / e.series.rate_Hz
    return f"estimation {estimation:.1f} s\nselection {e.scored_s - estimation:.1f} s"


def _format(value: float | None, decimals: int) -> str:
    return NONE if value is None else f"{value:.{decimals}f}"


def _format_newtons(value: float) -> str:
    """Return a force as text; a run that left its force envelope has none."""
    return NONE if not math.isfinite(value) else f"{value:.1f}" if value < 1e4 else f"{value:.0f}"


def _format_weighted_cost(e: Evaluation, weighting: Weighting) -> str:
    value = e.weighted_cost(weighting)
    return NONE if math.isnan(value) else percent(value)
