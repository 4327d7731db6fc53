"""The tables that page and terminal show: each column once, measured values beside those of each simulation."""

from __future__ import annotations

import math
from collections.abc import Callable
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
    Knee,
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
CONDITION: tuple[Column[Any], ...] = (
    Column("Current [A]", lambda r: number(r.current_A), figure=True, short="A"),
    Column("Amplitude [mm]", lambda r: number(1e3 * r.amplitude_m), figure=True, short="mm"),
    Column("Frequency [Hz]", lambda r: number(r.frequency_Hz), figure=True, short="Hz"),
    Column("Cycles", lambda r: str(r.cycles), figure=True, short="cycles"),
)
SOURCE: tuple[Column[Any], ...] = (
    Column("Force", lambda r: str(r.source), page_only=True),
    Column("Direction", lambda r: str(r.direction), page_only=True),
)
OneRow = TypeVar("OneRow", bound=ConditionRow)


def peak_table(results: Characteristics) -> Table[PeakForce]:
    """Return a row for each condition and direction: measured force, and each simulation's with its difference."""
    columns: list[Column[PeakForce]] = [
        *CONDITION,
        SOURCE[1],
        Column("Speed [m/s]", lambda r: number(r.speed_m_s), figure=True, short="m/s"),
        Column("Force [N]", lambda r: with_spread(r.force_N, r.force_sd_N, 4), figure=True, short="force\nN"),
        *_simulated(
            results,
            results.peak_velocity,
            "N",
            lambda r: number(r.force_N, 4),
            lambda r: with_spread(r.difference_N, r.difference_sd_N),
        ),
    ]
    title = "force at the peak speed (± standard deviation between cycles)"
    return Table(columns, _measured(results.peak_velocity), title)


def work_table(results: Characteristics) -> Table[CycleWork]:
    """Return a row for each condition: measured work, and each simulation's with its difference, or what it implies."""
    alone = len(results.sources) == 1  # in a terminal there is room for one or the other
    columns: list[Column[CycleWork]] = [
        *CONDITION,
        Column("Work [J]", lambda r: with_spread(r.work_J, r.work_sd_J, 4), figure=True, short="work\nJ"),
        *_simulated(
            results,
            results.work,
            "J",
            lambda r: number(r.work_J, 4),
            lambda r: with_spread(r.difference_J, r.difference_sd_J),
        ),
        Column(
            "Equivalent damping [Ns/m]",
            lambda r: number(r.damping_Ns_m),
            figure=True,
            short="damping\nNs/m",
            page_only=not alone,
        ),
        Column(
            "zero-speed\nwidth N",
            lambda r: with_spread(r.zero_width_N, r.zero_width_sd_N),
            figure=True,
            terminal_only=True,
            page_only=not alone,
        ),
        Column(
            "Rebound / compression", lambda r: number(r.rebound_ratio), figure=True, short="ratio", page_only=not alone
        ),
    ]
    rest = ", equivalent damping, hysteresis at zero speed, rebound over compression" if alone else ""
    return Table(columns, _measured(results.work), f"work per cycle{rest}")


def zero_speed_table(results: Characteristics) -> Table[CycleWork]:
    """Return a row for each condition: the measured forces at zero speed."""
    columns: list[Column[CycleWork]] = [
        *CONDITION,
        Column(
            "Width at zero speed [N]",
            lambda r: with_spread(r.zero_width_N, r.zero_width_sd_N),
            figure=True,
            page_only=True,
        ),
        Column("Per 1 ms of delay [N]", lambda r: number(r.zero_width_per_ms_N), figure=True, page_only=True),
        Column(
            "Mid force at zero speed [N]",
            lambda r: with_spread(r.mid_force_N, r.mid_force_sd_N),
            figure=True,
            page_only=True,
        ),
    ]
    return Table(columns, _measured(results.work))


def width_table(results: Characteristics) -> Table[tuple[ContinuousForce, ...]]:
    """Return a row for each condition and direction: the width of the hysteresis at WIDTH_SHARES of the peak speed.

    A row is all points of a curve, one for each of SHARES.
    """
    size, rows = len(SHARES), results.continuous
    first, middle, last = (int(abs(SHARES - share).argmin()) for share in WIDTH_SHARES)

    def width(k: int) -> Callable[[tuple[ContinuousForce, ...]], str]:
        return lambda curve: with_spread(curve[k].width_N, curve[k].width_sd_N)

    columns: list[Column[tuple[ContinuousForce, ...]]] = [
        *map(_of_curve, (*CONDITION, *SOURCE)),
        Column(Markup("Width at 25&#160;% [N]"), width(first), figure=True, page_only=True),
        Column(Markup("at 50&#160;% [N]"), width(middle), figure=True, page_only=True),
        Column(Markup("at 75&#160;% of the peak speed [N]"), width(last), figure=True, page_only=True),
        Column(
            Markup("Force at 50&#160;% [N]"),
            lambda curve: number(curve[middle].force_N, 4),
            figure=True,
            page_only=True,
        ),
    ]
    return Table(columns, [rows[k : k + size] for k in range(0, len(rows), size)])


def knee_table(results: Characteristics) -> Table[Knee]:
    """Return a row for each knee that was found."""
    columns: list[Column[Knee]] = [
        *CONDITION,
        *SOURCE,
        Column("Knee [m/s]", lambda r: with_spread(r.knee_speed_m_s, r.knee_speed_sd_m_s), figure=True, page_only=True),
        Column("Force there [N]", lambda r: number(r.knee_force_N), figure=True, page_only=True),
        Column("Slope below [Ns/m]", lambda r: number(r.slope_below_Ns_m), figure=True, page_only=True),
        Column("Slope above [Ns/m]", lambda r: number(r.slope_above_Ns_m), figure=True, page_only=True),
    ]
    return Table(columns, [row for row in results.knees if not row.note])


def response_table(results: Characteristics) -> Table[ValveResponse]:
    """Return a row for each kind of step and source, times in ms."""

    def time(name: str) -> Callable[[ValveResponse], str]:
        return lambda r: with_spread(1e3 * getattr(r, f"{name}_s"), 1e3 * getattr(r, f"{name}_ci95_s"))

    columns: list[Column[ValveResponse]] = [
        Column("From–to [A]", lambda r: f"{number(r.from_A)} to {number(r.to_A)}", page_only=True),
        Column("from-to\nA", lambda r: f"{number(r.from_A, 2)}-{number(r.to_A, 2)}", figure=True, terminal_only=True),
        Column("Direction", lambda r: r.direction, page_only=True),
        Column("Force", lambda r: r.source, page_only=True),
        Column("force", lambda r: r.source, figure=True, terminal_only=True),
        Column("Steps", lambda r: str(r.steps), figure=True, short="steps"),
        Column("Speed [m/s]", lambda r: number(r.speed_m_s), figure=True, page_only=True),
        Column("m/s", lambda r: number(r.speed_m_s, 2), figure=True, terminal_only=True),
        Column("Change [N]", lambda r: number(r.force_change_N), figure=True, page_only=True),
        Column("Dead time [ms]", time("dead_time"), figure=True, short="dead time\nms"),
        Column(Markup("63&#160;% after it [ms]"), time("time_constant"), figure=True, page_only=True),
        Column(Markup("63&#160;% after the step [ms]"), time("time_63"), figure=True, short="63 % after\nstep, ms"),
        Column(Markup("10 to 90&#160;% [ms]"), time("rise"), figure=True, short="10-90 %\nms"),
    ]
    return Table(columns, results.responses, "response of the valve (± half the 95 % interval)")


def recording_table(results: Characteristics) -> Table[RecordingFacts]:
    """Return a row for each recording: what the results rest on."""
    columns: list[Column[RecordingFacts]] = [
        Column("Recording", lambda r: r.name, page_only=True),
        Column("Length [s]", lambda r: number(r.duration_s), figure=True, page_only=True),
        Column("Rate [Hz]", lambda r: number(r.rate_Hz, 4), figure=True, page_only=True),
        Column("Bandwidth of the speed [Hz]", lambda r: number(r.bandwidth_Hz), figure=True, page_only=True),
        Column("Noise of the speed [mm/s]", lambda r: number(1e3 * r.speed_noise_m_s, 2), figure=True, page_only=True),
        Column("Noise of the force [N]", lambda r: number(r.force_noise_N, 2), figure=True, page_only=True),
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
    return Table(columns, [one for one in results.omissions if one.recording != "all"])


def choose_rows(table: Table[Any]) -> Table[Any]:
    """Return a table for the page: of many rows, those of evenly chosen conditions of each current."""
    conditions: dict[float, dict[tuple[float, float], list[Any]]] = {}
    for row in table.rows:
        one = row[0] if isinstance(row, tuple) else row
        of_current = conditions.setdefault(one.current_A, {})
        of_current.setdefault((one.amplitude_m, one.frequency_Hz), []).append(row)
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
    """Return `value ± spread`; without a spread the value with `figures` figures.

    The spread has one figure, or two if it begins with 1 or 2; the value is rounded to the same place.
    """
    if not (math.isfinite(value) and math.isfinite(spread) and spread > 0.0):
        return number(value, figures)
    decade = math.floor(math.log10(spread))
    digits = (1 if spread < 3.0 * 10.0**decade else 0) - decade
    return minus(f"{round(value, digits):.{max(digits, 0)}f} ± {round(spread, digits):.{max(digits, 0)}f}")


def _measured(rows: tuple[OneRow, ...]) -> list[OneRow]:
    return [row for row in rows if row.source == MEASURED]


def _simulated(
    results: Characteristics,
    rows: tuple[OneRow, ...],
    unit: str,
    value: Callable[[OneRow], str],
    difference: Callable[[OneRow], str],
) -> list[Column[OneRow]]:
    """Return for each simulation a column of its values and one of their differences; dashes where it has no force.

    A terminal shows both for one simulation, only the differences for several: they must fit in 80 columns.
    """
    found = {(row.source, *_condition(row)): row for row in rows}

    def cell(source: str, text: Callable[[OneRow], str]) -> Callable[[OneRow], str]:
        return lambda row: text(same) if (same := found.get((source, *_condition(row)))) else MISSING

    names, columns = results.sources[1:], []
    for name in names:
        short, label = (f"{name}\n{unit}", "difference\n") if len(names) == 1 else ("", f"{name}\ndifference ")
        columns.append(
            Column(
                f"{name} [{unit}]", cell(name, value), figure=True, head_css="as-is", short=short, page_only=not short
            )
        )
        columns.append(Column(f"Difference [{unit}]", cell(name, difference), figure=True, short=f"{label}{unit}"))
    return columns


def _of_curve(column: Column[Any]) -> Column[Any]:
    return replace(column, text=lambda curve: column.text(curve[0]))


def _condition(row: ConditionRow) -> tuple[Any, ...]:
    return row.current_A, row.amplitude_m, row.frequency_Hz, getattr(row, "direction", "")
