"""The table of costs of evaluations; the loss to a teacher; which seconds of a recording served for what.

When a model learns from a teacher's force instead of the measured one, three costs J say what is lost: model against
teacher, teacher against measurement, and model against measurement.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ces_data.arrays import F, Mask
from ces_data.reading import import_pandas
from ces_data.recording import Recording
from ces_identify.limits import TickLimits
from ces_identify.polynomial.problem import BLOCK_S, ESTIMATION_BLOCKS, PERIOD_BLOCKS, estimation_ticks
from ces_identify.prepare.cost import cost
from ces_identify.prepare.series import Series, prepare
from ces_identify.validation.evaluate import IDENTIFICATION, CostInterval, Evaluation
from ces_observer.model import Model
from ces_report.table import BAR, Column, PrintedResults, Table, summarize_result, text_table
from ces_report.typesetting import format_within

NONE = "\N{EN DASH}"
RULE = (
    f"of every {PERIOD_BLOCKS * BLOCK_S:g} s of identification data, the first {ESTIMATION_BLOCKS * BLOCK_S:g} s serve "
    f"estimation and the last {(PERIOD_BLOCKS - ESTIMATION_BLOCKS) * BLOCK_S:g} s selection; a last fit may use both; "
    "no choice used the test seconds"
)


def cost_table(
    evaluations: Sequence[Evaluation],
    title: str = "",
    exact: bool = True,
    anchors: Mapping[tuple[str, str], str] | None = None,
) -> Table[Evaluation]:
    """Return a table with a row for each evaluation; on a page, names (of a role) are links to their `anchors`.

    Columns: role and scored seconds, J and its 95 % interval, the noise floor of J where cycles repeat, the RMS
    error, the share of ticks outside the envelope, and that of measured forces inside the band, if the model has
    one. With `exact` the evaluations are those of the identification itself.
    """
    ends = [e.interval.high if e.interval else e.cost for e in evaluations if math.isfinite(e.cost)]
    scale = 100.0 / max([*ends, 1e-9])

    def link(e: Evaluation) -> Markup:
        anchor = (anchors or {}).get((e.name, e.role))
        return Markup('<a href="#{}">{}</a>').format(anchor, e.name) if anchor else Markup("{}").format(e.name)

    def role(e: Evaluation) -> Markup:
        return Markup('<span class="role {}">{}</span>').format(e.role, e.role)

    def bar(e: Evaluation) -> Markup:
        whisker = Markup('<span class="whisker" style="left:{:.1f}%;width:{:.1f}%"></span>')
        ends = e.interval and whisker.format(scale * e.interval.low, scale * (e.interval.high - e.interval.low))
        return BAR.format(percent(e.cost, e.interval), min(scale * e.cost, 100.0), ends or "")

    def cost_text(e: Evaluation) -> str:
        return percent(e.cost, e.interval)

    def use(e: Evaluation) -> str:
        return f"{e.role} {e.scored_s:.1f} s" if exact or e.role != IDENTIFICATION else e.role

    def span(e: Evaluation) -> str:
        return f"{e.series.time_s[0]:.1f}\N{EN DASH}{e.series.time_s[-1]:.1f}"

    def dropped(e: Evaluation) -> str:
        return f"{sum(e.series.dropped.values())} / {len(e.series.segments) - 1}"

    def reasons(e: Evaluation) -> str:
        return ", ".join(f"{reason}: {n}" for reason, n in e.series.dropped.items() if n)

    def number(of: Callable[[Evaluation], float | None], form: str) -> Callable[[Evaluation], str]:
        def text(e: Evaluation) -> str:
            value = of(e)
            return NONE if value is None or not math.isfinite(value) else f"{value:{form}}"

        return text

    floors, bands = (any(getattr(e, name) is not None for e in evaluations) for name in ("floor", "coverage"))
    columns: list[Column[Evaluation] | None] = [
        Column("Recording", lambda e: e.name, short="recording", html=link, css="name"),
        Column("role", use, terminal_only=True),
        Column("Role", lambda e: e.role, html=role, page_only=True),
        Column("From–to [s]", span, css="n spare", head_css="n spare", page_only=True),
        Column("Scored [s]", lambda e: f"{e.scored_s:.1f}", css="n spare", head_css="n spare", page_only=True),
        Column("J [%]", cost_text, figure=True, html=bar, css="j", head_css="j", short="J %"),
        Column("95 % interval [%]", lambda e: interval_text(e.interval), figure=True, short="95 %"),
        Column("Noise floor [%]", number(lambda e: e.floor, ".2f"), figure=True, short="floor") if floors else None,
        Column("RMS error [N]", number(lambda e: e.rms_N, ".1f"), figure=True, short="RMS N"),
        Column("Outside envelope [%]", number(lambda e: 100 * e.outside_share, ".1f"), figure=True, short="out %"),
        Column("Inside band [%]", number(lambda e: e.coverage and 100 * e.coverage, ".1f"), figure=True, short="band %")
        if bands
        else None,
        Column("Dropped / gaps", dropped, figure=True, small=reasons, page_only=True),
    ]
    return Table([column for column in columns if column is not None], evaluations, title)


class Evaluations(PrintedResults[Evaluation]):
    """Evaluations that print themselves as a table."""

    def to_frame(self) -> Any:
        """Return the costs as a DataFrame, a row for each recording: J with its interval [%], shares in percent."""
        rows = [
            {
                "recording": e.name,
                "role": e.role,
                "scored_s": e.scored_s,
                "J_percent": e.cost,
                "low_percent": e.interval.low if e.interval else math.nan,
                "high_percent": e.interval.high if e.interval else math.nan,
                "floor_percent": math.nan if e.floor is None else e.floor,
                "rms_N": e.rms_N,
                "outside_percent": 100.0 * e.outside_share,
                "band_percent": math.nan if e.coverage is None else 100.0 * e.coverage,
            }
            for e in self
        ]
        return import_pandas().DataFrame(rows)


@summarize_result.register
def _(evaluations: Evaluations) -> tuple[Sequence[str], Table[Evaluation]]:
    return [] if evaluations else ["no evaluation"], cost_table(evaluations, exact=False)


@summarize_result.register
def _(evaluation: Evaluation) -> tuple[Sequence[str], Table[Evaluation]]:
    return [], cost_table([evaluation], exact=False)


def known_cost_table(rows: Sequence[Mapping[str, Any]]) -> Table[Sequence[str]]:
    """Return the same from the rows of a model file, whose earlier versions hold fewer figures."""

    def text(row: Mapping[str, Any], key: str, form: str = ".1f") -> str:
        return f"{row[key]:{form}}" if isinstance(row.get(key), int | float) else NONE

    def cells(row: Mapping[str, Any]) -> list[str]:
        interval = CostInterval(row["low"], row["high"]) if {"low", "high"} <= _numbers(row) else None
        J = percent(row["J"], interval) if "J" in _numbers(row) else NONE
        names = [str(row.get(key, "")) for key in ("recording", "role")]
        return [*names, J, interval_text(interval), *(text(row, key) for key in ("rms_N", "outside", "band"))]

    heads = ["recording", "role", "J %", "95 %", "RMS N", "out %", "band %"]
    made = [cells(row) for row in rows]
    shown = [k for k in range(len(heads)) if k < 3 or any(row[k] != NONE for row in made)]
    return text_table([heads[k] for k in shown], [[row[k] for k in shown] for row in made], left=2)


def _numbers(row: Mapping[str, Any]) -> set[str]:
    return {key for key, value in row.items() if isinstance(value, int | float)}


def percent(cost: float, interval: CostInterval | None = None) -> str:
    """Return a cost J as text, with the digits of its interval; a force that is not finite has none."""
    if interval is not None:
        return format_within(cost, interval.low, interval.high)[0]
    return f"{cost:.2f}" if math.isfinite(cost) else "diverged"


def interval_text(interval: CostInterval | None) -> str:
    """Return an interval as text, a dash if there is none."""
    return NONE if interval is None else format_within(interval.low, interval.low, interval.high)[1]


@dataclass(frozen=True)
class DistillationCosts:
    """Costs J [%] on one recording; NaN without a measured force."""

    recording: str
    role: str
    model_to_teacher: float
    teacher_to_measured: float
    model_to_measured: float

    @property
    def loss(self) -> float:
        """By how much [%] the model's cost against the measured force exceeds its teacher's."""
        return self.model_to_measured - self.teacher_to_measured


def compare_with_teacher(
    model: Model, evaluations: Sequence[Evaluation], measured: Sequence[Recording]
) -> tuple[DistillationCosts, ...]:
    """Return the costs on evaluations with the teacher's force; `measured` are the original recordings."""
    with_force = [recording for recording in measured if "force" in recording.channels]
    prepared = [prepare(r, model.sampling) for r in with_force]
    costs = []
    for e in evaluations:
        force, both = _find_measured_force(e.series, prepared), e.series.scored
        both = both & np.isfinite(force)
        truth, enough = force[both], bool(both.sum() >= TickLimits.MIN_SCORED and np.ptp(force[both]) > 0.0)
        teacher, own = (cost(truth, x[both]) if enough else np.nan for x in (e.series.force, e.run.force))
        costs.append(DistillationCosts(e.name, e.role, e.cost, teacher, own))
    return tuple(costs)


def teacher_facts(
    model: Model, evaluations: Sequence[Evaluation], teacher: str, file: Path | None, measured: Sequence[Recording]
) -> dict[str, Any]:
    """Return what a model's provenance says of its `teacher`, which is in a `file` (None: in none)."""
    rows = [
        {
            key: v if isinstance(v, str) else round_finite(v)
            for key, v in {**asdict(comparison), "loss": comparison.loss}.items()
        }
        for comparison in compare_with_teacher(model, evaluations, measured)
    ]
    sha256 = None if file is None else hashlib.sha256(file.read_bytes()).hexdigest()
    return {"simulation": teacher, "sha256": sha256, "cost_J_percent": rows}


def round_finite(value: float) -> float | None:
    """Return a cost as the model file stores it; a run that diverged has none."""
    return round(value, 4) if math.isfinite(value) else None


def _find_measured_force(series: Series, measured: Sequence[Series]) -> F:
    """Return the measured force [N] on the ticks of `series` from the series that it is a part of, else NaN."""
    for whole in measured:
        begin = int(np.searchsorted(whole.time_s, series.time_s[0]))
        part = slice(begin, begin + len(series))
        if whole.name == series.name and np.array_equal(whole.position[part], series.position):
            return whole.force[part]
    return np.full(len(series), np.nan)


def usage(identified: Sequence[Series], held_out: Sequence[Series]) -> list[dict[str, Any]]:
    """Return a row for each series: its start and end [s], and its scored seconds of each kind."""
    rows = [_row(series, estimation_ticks(series)) for series in identified]
    return rows + [_row(series, None) for series in held_out]


def _row(series: Series, estimation: Mask | None) -> dict[str, Any]:
    scored, none = series.scored, np.zeros(len(series), bool)
    masks = (none, none, scored) if estimation is None else (scored & estimation, scored & ~estimation, none)
    seconds = [round(float(mask.sum()) * (1.0 / series.rate_Hz), 1) for mask in masks]
    return {
        "recording": series.name,
        "from_s": round(float(series.time_s[0]), 2),
        "to_s": round(float(series.time_s[-1]), 2),
        **dict(zip(("estimation_s", "selection_s", "test_s"), seconds, strict=True)),
    }
