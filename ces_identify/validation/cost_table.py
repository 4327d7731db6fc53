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
from typing import Any, TypeAlias

import numpy as np
from markupsafe import Markup

from ces_data.arrays import F, Mask
from ces_data.recording import Recording
from ces_identify.limits import TickLimits
from ces_identify.polynomial.problem import BLOCK_S, ESTIMATION_BLOCKS, PERIOD_BLOCKS, estimation_ticks
from ces_identify.prepare.cost import EQUAL, Weighting, cost
from ces_identify.prepare.series import Series, prepare
from ces_identify.validation.cost_frame import FramedResult, as_frame
from ces_identify.validation.evaluate import CostInterval, Evaluation
from ces_observer.model import Model
from ces_report.table import BAR, Column, PrintedResults, Table, summarize_result
from ces_report.typesetting import format_within

NONE = "\N{EN DASH}"
COSTS = "cost_J_percent"  # key in the provenance
RULE = (
    f"of every {PERIOD_BLOCKS * BLOCK_S:g} s of identification data, the first {ESTIMATION_BLOCKS * BLOCK_S:g} s serve "
    f"estimation and the last {(PERIOD_BLOCKS - ESTIMATION_BLOCKS) * BLOCK_S:g} s selection; a last fit may use both; "
    "no choice used the test seconds"
)


@dataclass(frozen=True, repr=False)
class KnownCost(FramedResult):
    """What a model file says of an evaluation, NaN and None where it does not; its names are those of `Evaluation`."""

    name: str
    role: str
    cost: float
    interval: CostInterval | None
    scored_s: float
    rms_N: float
    outside_share: float
    coverage: float | None
    floor: None = None


Cost: TypeAlias = Evaluation | KnownCost


def cost_table(
    evaluations: Sequence[Cost],
    title: str = "",
    weighting: Weighting = EQUAL,
    anchors: Mapping[tuple[str, str], str] | None = None,
) -> Table[Cost]:
    """Return a table with a row for each evaluation; on a page, names (of a role) are links to their `anchors`.

    Columns: role and scored seconds, J and its 95 % interval, the noise floor of J where cycles repeat, the weighted
    J if there are weights, the RMS error, the share of ticks outside the envelope, and that of measured forces inside
    the band. Of the figures after the interval, those that no row has are left out.
    """
    ends = [e.interval.high if e.interval else e.cost for e in evaluations if math.isfinite(e.cost)]
    scale = 100.0 / max([*ends, 1e-9])

    def link(e: Cost) -> Markup:
        anchor = (anchors or {}).get((e.name, e.role))
        return Markup('<a href="#{}">{}</a>').format(anchor, e.name) if anchor else Markup("{}").format(e.name)

    def role(e: Cost) -> Markup:
        return Markup('<span class="role {}">{}</span>').format(e.role, e.role)

    def bar(e: Cost) -> Markup:
        whisker = Markup('<span class="whisker" style="left:{:.1f}%;width:{:.1f}%"></span>')
        ends = e.interval and whisker.format(scale * e.interval.low, scale * (e.interval.high - e.interval.low))
        return BAR.format(percent(e.cost, e.interval), min(scale * e.cost, 100.0), ends or "")

    def cost_text(e: Cost) -> str:
        return percent(e.cost, e.interval)

    def span(e: Evaluation) -> str:
        return f"{e.series.time_s[0]:.1f}\N{EN DASH}{e.series.time_s[-1]:.1f}"

    def dropped(e: Evaluation) -> str:
        return f"{sum(e.series.dropped.values())} / {len(e.series.segments) - 1}"

    def reasons(e: Evaluation) -> str:
        return ", ".join(f"{reason}: {n}" for reason, n in e.series.dropped.items() if n)

    def of_run(text: Callable[[Evaluation], str]) -> Callable[[Cost], str]:
        return lambda e: text(e) if isinstance(e, Evaluation) else ""

    def weighted(e: Cost) -> float | None:
        return e.weighted_cost(weighting) if weighting and isinstance(e, Evaluation) else None

    def number(of: Callable[[Cost], float | None], form: str) -> Callable[[Cost], str]:
        def text(e: Cost) -> str:
            value = of(e)
            return NONE if value is None or not math.isfinite(value) else f"{value:{form}}"

        return text

    figures: list[Column[Cost]] = [
        Column("Noise floor [%]", number(lambda e: e.floor, ".2f"), figure=True, short="floor"),
        Column("Weighted J [%]", number(weighted, ".2f"), figure=True, short="weighted"),
        Column("RMS error [N]", number(lambda e: e.rms_N, ".1f"), figure=True, short="RMS N"),
        Column("Outside envelope [%]", number(lambda e: 100 * e.outside_share, ".1f"), figure=True, short="out %"),
        Column(
            "Inside band [%]", number(lambda e: e.coverage and 100 * e.coverage, ".1f"), figure=True, short="band %"
        ),
    ]
    columns: list[Column[Cost]] = [
        Column("Recording", lambda e: e.name, short="recording", html=link, css="name"),
        Column("role", _describe_use, terminal_only=True),
        Column("Role", lambda e: e.role, html=role, page_only=True),
        Column("From–to [s]", of_run(span), css="n spare", head_css="n spare", page_only=True),
        Column("Scored [s]", number(lambda e: e.scored_s, ".1f"), css="n spare", head_css="n spare", page_only=True),
        Column("J [%]", cost_text, figure=True, html=bar, css="j", head_css="j", short="J %"),
        Column("95 % interval [%]", lambda e: interval_text(e.interval), figure=True, short="95 %"),
        *(c for c in figures if any(c.text(e) != NONE for e in evaluations)),
        Column("Dropped / gaps", of_run(dropped), figure=True, small=of_run(reasons), page_only=True),
    ]
    return Table(columns, evaluations, title)


class Evaluations(PrintedResults[Evaluation]):
    """Evaluations that print themselves as a table."""

    def to_frame(self) -> Any:
        """Return the costs as a DataFrame, a row for each recording: J with its interval [%], shares in percent."""
        return as_frame(self)


@summarize_result.register
def _(evaluations: Evaluations) -> tuple[Sequence[str], Table[Cost]]:
    return [] if evaluations else ["no evaluation"], cost_table(evaluations)


@summarize_result.register
def _(evaluation: Evaluation) -> tuple[Sequence[str], Table[Cost]]:
    return [], cost_table([evaluation])


class KnownCosts(PrintedResults[KnownCost]):
    """Costs in a model file, printed as those of its identification were."""

    @classmethod
    def of(cls, model: Model) -> KnownCosts:
        """Return those that the provenance of a model names; earlier versions wrote fewer figures."""
        rows = model.provenance.get(COSTS)
        return cls(_read_cost(row) for row in (rows if isinstance(rows, list) else ()) if isinstance(row, dict))

    def to_frame(self) -> Any:
        """Return the costs as a DataFrame, as `Evaluations` do."""
        return as_frame(self)


def _read_cost(row: Mapping[str, Any]) -> KnownCost:
    """Return a row of a model file."""
    given = {key: float(value) for key, value in row.items() if isinstance(value, int | float)}
    interval = CostInterval(given["low"], given["high"]) if {"low", "high"} <= {*given} else None
    seconds, rms_N, outside, band, J = (
        given.get(key, math.nan) for key in ("scored_s", "rms_N", "outside", "band", "J")
    )
    name, role = (str(row.get(key, "")) for key in ("recording", "role"))
    coverage = 0.01 * band if math.isfinite(band) else None
    return KnownCost(name, role, J, interval, seconds, rms_N, 0.01 * outside, coverage)


@summarize_result.register
def _(costs: KnownCosts) -> tuple[Sequence[str], Table[Cost]]:
    return [] if costs else ["the model file names no costs"], cost_table(costs)


@summarize_result.register
def _(known: KnownCost) -> tuple[Sequence[str], Table[Cost]]:
    return [], cost_table([known])


def percent(cost: float, interval: CostInterval | None = None) -> str:
    """Return a cost J as text, with the digits of its interval; a force that is not finite has none."""
    if interval is not None:
        return format_within(cost, interval.low, interval.high)[0]
    return f"{cost:.2f}" if math.isfinite(cost) else "diverged"


def interval_text(interval: CostInterval | None) -> str:
    """Return an interval as text, a dash if there is none."""
    return NONE if interval is None else format_within(interval.low, interval.low, interval.high)[1]


def _describe_use(e: Evaluation | KnownCost) -> str:
    """Return the role of an evaluation with its scored seconds, if they are known."""
    return f"{e.role} {e.scored_s:.1f} s" if math.isfinite(e.scored_s) else e.role


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
