"""The tables that page and terminal show: each column once, measured values beside those of each simulation."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from markupsafe import Markup

from ces_identify.characteristics.cycles import SHARES
from ces_identify.characteristics.motion import MEASURED
from ces_identify.characteristics.rows import (
    Characteristics,
    ConditionRow,
    ContinuousForce,
    CycleWork,
    Omission,
    PeakForce,
    RecordingFacts,
    ValveResponse,
)
from ces_report.table import Column, Table
from ces_report.typesetting import minus

MAX_ROWS = 60  # of a table on the page, about; the CSV file has all
WIDTH_SHARES = (0.25, 0.5, 0.75)  # of the peak speed, at which the page shows the hysteresis
MISSING = "–"
OneRow = TypeVar("OneRow", bound=ConditionRow)


def peak_table(results: Characteristics) -> Table[PeakForce]:
    """Return a row for each condition and direction: measured force, and each simulation's with its difference."""
    columns: list[Column[PeakForce]] = [
        *CONDITION,
        DIRECTION,
        _number("Speed [m/s]", "speed_m_s", short="m/s"),
        _spread("Force [N]", "force", "N", 4, short="force\nN"),
        *_list_simulated(results, results.peak_velocity, "force", "N"),
    ]
    title = "force at the peak speed (± standard deviation between cycles)"
    return Table(columns, _select_measured(results.peak_velocity), title)


def work_table(results: Characteristics) -> Table[CycleWork]:
    """Return a row for each condition: measured work, and each simulation's with its difference, or what it implies."""
    alone = len(results.sources) == 1  # in a terminal there is room for one or the other
    columns: list[Column[CycleWork]] = [
        *CONDITION,
        _spread("Work [J]", "work", "J", 4, short="work\nJ"),
        *_list_simulated(results, results.work, "work", "J"),
        _number("Equivalent damping [Ns/m]", "damping_Ns_m", short="damping\nNs/m" * alone),
        _number("Rebound / compression", "rebound_ratio", short="ratio" * alone),
    ]
    if alone:
        columns.insert(-1, replace(_spread("zero-speed\nwidth N", "zero_width", "N", short=""), **IN_TERMINAL))
    others = ", equivalent damping, hysteresis at zero speed, rebound over compression" if alone else ""
    return Table(columns, _select_measured(results.work), f"work per cycle{others}")


def zero_speed_table(results: Characteristics) -> Table[CycleWork]:
    """Return a row for each condition: the measured forces at zero speed."""
    columns: list[Column[CycleWork]] = [
        *CONDITION,
        _spread("Width at zero speed [N]", "zero_width", "N"),
        _number("Per 1 ms of delay [N]", "zero_width_per_ms_N"),
        _spread("Mid force at zero speed [N]", "mid_force", "N"),
    ]
    return Table(columns, _select_measured(results.work))


def width_table(results: Characteristics) -> Table[tuple[ContinuousForce, ...]]:
    """Return the hysteresis width at WIDTH_SHARES of the peak speed; a row is a curve: its points at all SHARES."""
    size, rows = len(SHARES), results.continuous
    first, middle, last = (int(abs(SHARES - share).argmin()) for share in WIDTH_SHARES)
    columns: list[Column[tuple[ContinuousForce, ...]]] = [
        *(_of_point(0, column) for column in (*CONDITION, SOURCE, DIRECTION)),
        _of_point(first, _spread(Markup("Width at 25&#160;% [N]"), "width", "N")),
        _of_point(middle, _spread(Markup("at 50&#160;% [N]"), "width", "N")),
        _of_point(last, _spread(Markup("at 75&#160;% of the peak speed [N]"), "width", "N")),
        _of_point(middle, _number(Markup("Force at 50&#160;% [N]"), "force_N", 4)),
    ]
    return Table(columns, [rows[k : k + size] for k in range(0, len(rows), size)])


def response_table(results: Characteristics) -> Table[ValveResponse]:
    """Return a row for each kind of step and source, times in ms."""
    columns: list[Column[ValveResponse]] = [
        Column("From–to [A]", lambda r: f"{number(r.from_A)} to {number(r.to_A)}", page_only=True),
        Column("from-to\nA", lambda r: f"{number(r.from_A, 2)}-{number(r.to_A, 2)}", figure=True, terminal_only=True),
        DIRECTION,
        SOURCE,
        replace(SOURCE, heading="force", figure=True, **IN_TERMINAL),
        Column("Steps", lambda r: str(r.steps), figure=True, short="steps"),
        _number("Speed [m/s]", "speed_m_s"),
        replace(_number("m/s", "speed_m_s", 2), **IN_TERMINAL),
        _number("Change [N]", "force_change_N"),
        _time("Dead time [ms]", "dead_time", short="dead time\nms"),
        _time(Markup("63&#160;% after it [ms]"), "time_constant"),
        _time(Markup("63&#160;% after the step [ms]"), "time_63", short="63 % after\nstep, ms"),
        _time(Markup("10 to 90&#160;% [ms]"), "rise", short="10-90 %\nms"),
    ]
    return Table(columns, results.responses, "response of the valve (± half the 95 % interval)")


def recording_table(results: Characteristics) -> Table[RecordingFacts]:
    """Return a row for each recording: what the results rest on."""
    columns: list[Column[RecordingFacts]] = [
        Column("Recording", lambda r: r.name, page_only=True),
        _number("Length [s]", "duration_s"),
        _number("Rate [Hz]", "rate_Hz", 4),
        _number("Bandwidth of the speed [Hz]", "bandwidth_Hz"),
        _number("Noise of the speed [mm/s]", "speed_noise_m_s", 2, scale=1e3),
        _number("Noise of the force [N]", "force_noise_N", 2),
        Column("Cycles used / found", lambda r: f"{r.cycles_used} / {r.cycles}", figure=True, page_only=True),
    ]
    return Table(columns, results.recordings)


def omission_table(results: Characteristics) -> Table[Omission]:
    """Return a row for each reason why something in a recording was not used."""
    columns: list[Column[Omission]] = [
        Column("What", lambda o: o.subject, page_only=True),
        Column("Recording", lambda o: o.recording, page_only=True),
        Column("How many", lambda o: f"{o.count} of {o.of}", figure=True, page_only=True),
        Column("Reason", lambda o: o.reason, page_only=True),
    ]
    return Table(columns, [omission for omission in results.omissions if omission.recording != "all"])


def choose_rows(table: Table[Any]) -> Table[Any]:
    """Return a table for the page: of many rows, those of evenly chosen conditions of each current."""
    conditions: dict[float, dict[tuple[float, float], list[Any]]] = {}
    for row in table.rows:
        point = row[0] if isinstance(row, tuple) else row
        of_current = conditions.setdefault(point.current_A, {})
        of_current.setdefault((point.amplitude_m, point.frequency_Hz), []).append(row)
    every = max(1, math.ceil(len(table.rows) / MAX_ROWS))
    shown = [row for own in conditions.values() for some in list(own.values())[::every] for row in some]
    return replace(table, rows=shown, left_out=len(table.rows) - len(shown))


def number(value: float, figures: int = 3) -> str:
    """Return a number with `figures` figures and a minus sign, a dash for NaN."""
    if not math.isfinite(value):
        return MISSING
    digits = figures - 1 - (math.floor(math.log10(abs(value))) if value else 0)
    return minus(f"{round(value, digits):.{max(digits, 0)}f}")


def with_spread(value: float, spread: float, figures: int = 3) -> str:
    """Return `value ± spread`, to one figure of the spread, two if it begins with 1 or 2; `figures` without spread."""
    if not (math.isfinite(value) and math.isfinite(spread) and spread > 0.0):
        return number(value, figures)
    decade = math.floor(math.log10(spread))
    digits = (1 if spread < 3.0 * 10.0**decade else 0) - decade
    return minus(f"{round(value, digits):.{max(digits, 0)}f} ± {round(spread, digits):.{max(digits, 0)}f}")


def _figures(heading: str, text: Callable[[Any], str], short: str) -> Column[Any]:
    """Return a column of figures, only for pages if it has no `short` heading."""
    return Column(heading, text, figure=True, short=short, page_only=not short)


def _number(heading: str, name: str, figures: int = 3, scale: float = 1.0, short: str = "") -> Column[Any]:
    return _figures(heading, lambda r: number(scale * getattr(r, name), figures), short)


def _spread(heading: str, name: str, unit: str, figures: int = 3, short: str = "") -> Column[Any]:
    """Return a column of values with their standard deviation."""
    value, sd = f"{name}_{unit}", f"{name}_sd_{unit}"
    return _figures(heading, lambda r: with_spread(getattr(r, value), getattr(r, sd), figures), short)


def _time(heading: str, name: str, short: str = "") -> Column[Any]:
    """Return a column of times [ms] with half their interval."""
    value, half = f"{name}_s", f"{name}_ci95_s"
    return _figures(heading, lambda r: with_spread(1e3 * getattr(r, value), 1e3 * getattr(r, half)), short)


def _of_point(number: int, column: Column[Any]) -> Column[Any]:
    """Return a column of one point of a curve."""
    return replace(column, text=lambda curve: column.text(curve[number]))


def _select_measured(rows: Sequence[OneRow]) -> list[OneRow]:
    return [row for row in rows if row.source == MEASURED]


def _list_simulated(results: Characteristics, rows: Sequence[ConditionRow], name: str, unit: str) -> list[Column[Any]]:
    """Return each simulation's values and differences; a terminal has room for the values of one simulation only."""

    def condition(row: ConditionRow) -> tuple[Any, ...]:
        return row.current_A, row.amplitude_m, row.frequency_Hz, getattr(row, "direction", "")

    def of_source(source: str, column: Column[Any]) -> Column[Any]:
        same = {condition(row): row for row in rows if row.source == source}
        return replace(column, text=lambda row: column.text(same[key]) if (key := condition(row)) in same else MISSING)

    columns = []
    for source in results.sources[1:]:
        short, label = (
            (f"{source}\n{unit}", "difference\n") if len(results.sources) == 2 else ("", f"{source}\ndifference ")
        )
        value = replace(_number(f"{source} [{unit}]", f"{name}_{unit}", 4, short=short), head_css="as-is")
        difference = _spread(f"Difference [{unit}]", "difference", unit, short=f"{label}{unit}")
        columns += [of_source(source, value), of_source(source, difference)]
    return columns


IN_TERMINAL: dict[str, Any] = {"page_only": False, "terminal_only": True}
SOURCE: Column[Any] = Column("Force", lambda r: str(r.source), page_only=True)
DIRECTION: Column[Any] = Column("Direction", lambda r: str(r.direction), page_only=True)
CONDITION: tuple[Column[Any], ...] = (
    _number("Current [A]", "current_A", short="A"),
    _number("Amplitude [mm]", "amplitude_m", scale=1e3, short="mm"),
    _number("Frequency [Hz]", "frequency_Hz", short="Hz"),
    Column("Cycles", lambda r: str(r.cycles), figure=True, short="cycles"),
)
