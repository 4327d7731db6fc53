"""The tables of a diagnosis, each declared once for page and terminal: causes, recalibration, recordings."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from markupsafe import Markup

from ces_gap.diagnosis import (
    AMBIGUOUS,
    NAMED,
    NOTHING,
    OUTSIDE,
    CalibrationCell,
    Diagnosis,
    Estimate,
    Explanation,
    GapRegion,
    HeldOutSeries,
    Possibility,
    calibration_cells,
    find_closest,
)
from ces_gap.effects.effect import Effect, Setting
from ces_gap.effects.refitted import NetworkPart
from ces_gap.inference.judgement import CALIBRATION, PARAMETERS
from ces_gap.inputs.probe_result import ProbeFinding
from ces_gap.limits import RegionLimits
from ces_gap.report.formatting import (
    effect_name,
    join_effect_names,
    newtons,
    parameter_as_declared,
    parameter_text,
    percent,
    percents,
    region_name,
    sentence_case,
)
from ces_identify.characteristics.rows import TABLES as CHARACTERISTICS
from ces_report.table import BAR, Column, Table, row_fields
from ces_report.typesetting import format_number, format_range, minus, three_figures

MAX_ROWS = 6  # effects with a row of their own
TOGETHER = "together"
ALWAYS = 3  # as many effects always have a row
MIN_PROBABILITY = 0.005  # of a further effect with a row
MAX_REGIONS = 10  # in the before-after table


@dataclass(frozen=True)
class ParameterText:
    """A parameter as text: description, and a warning if its value is not reliable."""

    name: str
    value: str
    unit: str
    interval: str
    what: str
    warning: str

    def __str__(self) -> str:
        """Return the parameter on one line."""
        return f"{' '.join(filter(None, (self.name, self.value, self.unit)))} [{self.interval}] {self.warning}".rstrip()

    def to_html(self) -> Markup:
        """Return the parameter as an item of a list."""
        warning = Markup(" <em>{}</em>").format(self.warning) if self.warning else ""
        what = Markup("<small>{}</small>").format(self.what) if self.what else ""
        unit = f"\N{NO-BREAK SPACE}{self.unit}" if self.unit else ""
        item = Markup("<li>{} <b>{}{}</b> <span>({})</span>{}{}</li>")
        return item.format(self.name, self.value, unit, self.interval, warning, what)


@dataclass(frozen=True)
class CauseRow:
    """One possibility as texts; `cause` is None of what is no effect.

    `css` is "named" if the verdict names the effect, or leaves it possible, and "left" for what is no effect; `bench`
    is where a test bench shows it.
    """

    effect: str
    what: str
    form: str
    css: str
    probability: float
    parameters: tuple[ParameterText, ...] = ()
    cause: Explanation | None = None
    bench: str = ""

    @property
    def unknown(self) -> bool:
        """Whether a number of the effect is not known from these recordings."""
        c = self.cause
        return c is not None and not all(map(math.isfinite, (c.gap_after_N, c.shrink, *c.shrink_ci95)))


def parameter_list(parameters: Sequence[ParameterText]) -> Markup:
    """Return parameters as a list for a page."""
    return Markup('<ul class="parameters">{}</ul>').format(Markup("").join(p.to_html() for p in parameters))


CAUSE_COLUMNS: tuple[Column[CauseRow], ...] = (
    Column(
        "Cause",
        lambda r: f"{r.effect} ({r.form})" if r.form else r.effect,
        html=lambda r: Markup("{}<small>{}</small>").format(
            r.effect, " · ".join(filter(None, (r.what, r.form, r.bench)))
        ),
        css="cause",
    ),
    Column(
        "Probability [%]",
        lambda r: percent(r.probability),
        html=lambda r: BAR.format(percent(r.probability), 100.0 * r.probability, ""),
        css="chance-of",
    ),
    Column(
        "Parameters (95\N{NO-BREAK SPACE}% interval)",
        lambda r: ", ".join(map(str, r.parameters)),
        html=lambda r: parameter_list(r.parameters) if r.cause is not None else Markup(""),
        page_only=True,
    ),
    Column("Gap left [N]", lambda r: three_figures(r.cause.gap_after_N) if r.cause else "", figure=True),
    Column(
        "Shrink [%]",
        lambda r: percent(r.cause.shrink) if r.cause else "",
        figure=True,
        small=lambda r: percents(r.cause.shrink_ci95) if r.cause and math.isfinite(r.cause.shrink) else "",
        css="shrunk",
    ),
)


def cause_table(d: Diagnosis) -> Table[CauseRow]:
    """Return the probable causes, most probable first, and below them what is no effect of the library."""
    return Table(CAUSE_COLUMNS, cause_rows(d), "probable causes")


def cause_notes(d: Diagnosis) -> list[str]:
    """Return sentences on what the rows mean, and the effects that have none."""
    notes = ["Effects in one row act together; each of them has the probability of all."] * d.is_combined
    own = "Shrink is of the whole gap; other effects stand beside the changed parameters, and theirs is what they add."
    notes += [own] * d.is_recalibrated
    notes += ["\N{EN DASH}: not known from these recordings."] * any(row.unknown for row in cause_rows(d))
    others = effects_without_row(d)
    return [*notes, f"Less probable: {', '.join(others)}."] if others else notes


def cause_rows(d: Diagnosis) -> list[CauseRow]:
    """Return a row for each possibility but the least probable effects; several that act together come first."""
    named = {*d.composition.effects, *d.alternatives} if d.verdict in (NAMED, AMBIGUOUS) else set()
    closest, rows, count = find_closest(d), [], 0
    for one in d.possibilities:
        row = _cause_row(one)
        alone = len(one.effects) == 1 and one.explanation is not None
        is_named = {*one.effects} <= named
        count += alone
        probable = count <= ALWAYS or (count <= MAX_ROWS and one.probability >= MIN_PROBABILITY)
        if not alone or probable or is_named or one.explanation is closest:
            rows.append(replace(row, css="named") if is_named else row)
    return rows


NO_EFFECTS = {OUTSIDE: ("an effect outside the library", "outside"), NOTHING: ("only noise and error", "nothing")}


def _cause_row(one: Possibility) -> CauseRow:
    """Return the row of an effect, of several together, or of what is none."""
    cause = one.explanation
    if cause is None or not cause.effects:
        (name,) = one.effects or (NOTHING,)
        what, css = NO_EFFECTS[name]
        return CauseRow(name, what, "", f"left {css}", one.probability)
    settings, names = cause.composition.settings, join_effect_names(cause.effects)
    if len(settings) != 1:
        return CauseRow(names, TOGETHER, "", "", one.probability, cause=cause)
    return CauseRow(
        effect=names,
        what=settings[0].effect.summary,
        form=join_effect_names(cause.forms),
        css="",
        probability=one.probability,
        bench=_find_on_bench(settings[0].effect),
        parameters=describe_parameters(cause.estimates[0], settings[0]),
        cause=cause,
    )


def _find_on_bench(effect: Effect) -> str:
    """Return the column of `ces characterise` in which the effect shows, empty if it is no single one."""
    table, column = effect.bench
    return f"in ces characterise: {row_fields(CHARACTERISTICS[table])[column].heading} ({table}.csv)" if table else ""


def explained_table(explanations: Sequence[Explanation]) -> Table[CauseRow]:
    """Return a row for each explanation, for scripts."""
    rows = [_cause_row(Possibility(one.effects, one.probability, one)) for one in explanations]
    return Table(CAUSE_COLUMNS, rows)


def effects_without_row(d: Diagnosis) -> list[str]:
    """Return the names of the effects that have no row."""
    shown = {row.effect for row in cause_rows(d)}
    return [name for name in (effect_name(c.effects[0]) for c in d.causes) if name not in shown]


def describe_parameters(estimates: Sequence[Estimate], setting: Setting) -> tuple[ParameterText, ...]:
    """Return the parameters as text; those of a calibration are shown as a table of its map instead."""
    if setting.name == CALIBRATION:
        return ()
    what = {p.name: p.what for p in setting.effect.parameters}
    moved = setting.effect.read_quantities() if isinstance(setting.effect, NetworkPart) else {}
    names = [name.removesuffix("]").split(" [") for name in moved]
    quantities = tuple(
        ParameterText(name, format_number(value), unit, "the static map has none", "", "")
        for (name, unit), value in zip(names, moved.values(), strict=True)
    )
    return quantities + tuple(
        ParameterText(
            *(parameter_as_declared(e) if setting.name == PARAMETERS else parameter_text(e)),
            what.get(e.name, ""),
            ", ".join(["at its bound"] * e.at_bound + ["differs between folds"] * e.drifts),
        )
        for e in estimates
    )


def describe_explanation(one: Explanation) -> list[str]:
    """Return a line for each effect that has parameters, with the gap that is left without it."""
    lines, gaps = [], one.without_N or (math.nan,) * len(one.effects)
    for name, found, setting, gap_N in zip(one.effects, one.estimates, one.composition.settings, gaps, strict=True):
        texts = [*map(str, describe_parameters(found, setting))]
        texts += [f"without it {newtons(gap_N)} are left"] * math.isfinite(gap_N)
        lines += [f"{effect_name(name)}: {', '.join(texts)}"] if texts else []
    return lines


Part = tuple[str, str, tuple[ParameterText, ...], float]  # effect, form, parameters, and the gap [N] left without it


def composition_table(d: Diagnosis) -> Table[Part] | None:
    """Return effect, form and jointly fitted parameters of a composition of several effects; None for a single one."""
    c = d.composition
    if len(c.effects) < 2:
        return None
    gaps = c.without_N or (math.nan,) * len(c.effects)
    parts = zip(c.effects, c.forms, c.estimates, c.composition.settings, gaps, strict=True)
    rows = [
        (effect_name(e), effect_name(f), describe_parameters(of_effect, s), gap) for e, f, of_effect, s, gap in parts
    ]
    columns: tuple[Column[Part], ...] = (
        Column("", lambda part: part[0], small=lambda part: part[1], css="cause"),
        Column("", lambda part: ", ".join(map(str, part[2])), html=lambda part: parameter_list(part[2])),
        Column("Gap without it [N]", lambda part: three_figures(part[3]), figure=True),
    )
    return Table(columns, rows)


CellRow = tuple[CalibrationCell, ...]  # those of one range of speed


def calibration_table(d: Diagnosis) -> Table[CellRow] | None:
    """Return the map of a calibration [N]: ranges of current as columns, of speed as rows; None without one."""
    cells = calibration_cells(d)
    if not cells:
        return None
    currents = list(dict.fromkeys(c.current_A for c in cells))
    speeds = list(dict.fromkeys(c.speed_m_s for c in cells))
    rows = [tuple(c for c in cells if c.speed_m_s == speed) for speed in speeds]

    def force_at(current_A: tuple[float, float]) -> Callable[[CellRow], str]:
        return lambda row: next((minus(f"{c.force_N:+.1f}") for c in row if c.current_A == current_A), "")

    columns: list[Column[CellRow]] = [Column("Speed [m/s]", lambda row: format_range(*row[0].speed_m_s))]
    columns += [Column(f"{format_range(*i)}\N{NO-BREAK SPACE}A", force_at(i), figure=True) for i in currents]
    return Table(columns, rows, "what the recalibration adds to the simulated force [N]")


PROBE_COLUMNS: tuple[Column[ProbeFinding], ...] = (
    Column("Asked", lambda f: f.about),
    Column("Found", lambda f: f.found),
    Column("Meaning", lambda f: sentence_case(f.meaning)),
)


def probe_table(d: Diagnosis) -> Table[ProbeFinding] | None:
    """Return what the simulation does to its inputs; None if nothing was found."""
    return Table(PROBE_COLUMNS, d.probe.findings) if d.probe.findings else None


RegionGap = tuple[GapRegion, float]  # a region and the gap after [N] in it


def region_table(d: Diagnosis) -> Table[RegionGap] | None:
    """Return the gap before and after in the regions where it is significantly larger than elsewhere; None without."""
    regions = [(r, after) for r, after in d.by_region if r.q_value <= RegionLimits.SIGNIFICANT][:MAX_REGIONS]
    longest = max([max(r.rms_N, after) for r, after in regions] + [1e-9])

    def bars(row: RegionGap) -> Markup:
        bar = Markup('<i class="was" style="width:{:.1f}%"></i><i class="is" style="width:{:.1f}%"></i>')
        return bar.format(100.0 * row[0].rms_N / longest, 100.0 * row[1] / longest)

    columns: tuple[Column[RegionGap], ...] = (
        Column("Region", lambda row: region_name(row[0])),
        Column("", lambda row: "", html=bars, css="pairbar", page_only=True),
        Column(
            "RMS gap, before and after [N]",
            lambda row: f"{three_figures(row[0].rms_N)} to {three_figures(row[1])}",
            figure=True,
            html=lambda row: Markup("{} → <b>{}</b>").format(three_figures(row[0].rms_N), three_figures(row[1])),
        ),
    )
    return Table(columns, regions) if regions else None


RECORDING_COLUMNS: tuple[Column[HeldOutSeries], ...] = (
    Column("Held-out recording", lambda s: s.trace.name),
    Column("Usable [s]", lambda s: f"{float(s.trace.usable.sum()) * s.trace.step_s:.1f}", figure=True),
    Column(
        "SHA-256",
        lambda s: s.trace.recording.sha256 or "in memory",
        html=lambda s: Markup('<span class="hash">{}</span>').format(s.trace.recording.sha256 or "in memory"),
    ),
)


def recording_table(d: Diagnosis) -> Table[HeldOutSeries]:
    """Return the held-out recordings with their usable seconds and their hashes."""
    return Table(RECORDING_COLUMNS, d.held_out)
