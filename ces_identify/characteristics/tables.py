"""The tables of the page and of the terminal: measured rows, and each simulation beside them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

from ces_identify.characteristics.cycles import SHARES
from ces_identify.characteristics.motion import MEASURED
from ces_identify.characteristics.rows import (
    Characteristics,
    ConditionRow,
    ContinuousForce,
    ControlRange,
    CurrentForce,
    CycleWork,
    JudgedValue,
    Omission,
    PeakForce,
    RecordingFacts,
    ValveResponse,
)
from ces_report.table import Column, Table, columns_of, row_fields

MAX_ROWS = 60  # of a table on the page, about; the CSV file has all
WIDTH_SHARES = {0.25: "Width at 25\N{NO-BREAK SPACE}% of the peak speed [N]", 0.5: "at 50\N{NO-BREAK SPACE}%"}
WIDTH_SHARES |= {0.75: "at 75\N{NO-BREAK SPACE}%"}  # at which the page shows the hysteresis
MISSING = "–"
CONDITION = ("current_A", "amplitude_m", "frequency_Hz", "cycles")
OneRow = TypeVar("OneRow", bound=ConditionRow | ControlRange)


def peak_table(results: Characteristics) -> Table[PeakForce]:
    """Return a row for each condition and direction: measured force, and each simulation's with its difference."""
    corrected = ("raw_N",) if results.rules.gas_force_N else ()
    columns = columns_of(PeakForce, *CONDITION, "direction", "speed_m_s", "force_N", *corrected)
    columns += _list_simulated(results, results.peak_velocity, "force_N", "difference_N")
    title = f"{results.rules.force_sentence} \N{PLUS-MINUS SIGN}: standard deviation between cycles."
    return Table(columns, _select_measured(results.peak_velocity), title)


def range_table(results: Characteristics) -> Table[ControlRange]:
    """Return a row for each speed and direction: what the valve can do, and each simulation's range."""
    names = ["direction", "speed_m_s", "soft_A", "hard_A", "soft_N", "hard_N", "range_N", "ratio"]
    names += ["hysteresis_N"] * _has_branches(results)
    columns = columns_of(ControlRange, *names)
    columns += _list_simulated(results, results.ranges, "range_N", "difference_N")
    title = "Range from the softest to the hardest current (± half the 95 % interval)."
    return Table(columns, _select_measured(results.ranges), title)


def current_table(results: Characteristics) -> Table[CurrentForce]:
    """Return a row for each speed, direction and current: linearity, and hysteresis between the branches."""
    columns = columns_of(CurrentForce, "direction", "speed_m_s", "current_A", "cycles", "force_N", "linearity")
    if _has_branches(results):
        columns += columns_of(CurrentForce, "raised_N", "lowered_N", "width_N", "width_share")
    columns += _list_simulated(results, results.over_current, "force_N", "difference_N")
    return Table(columns, _select_measured(results.over_current))


def _has_branches(results: Characteristics) -> bool:
    """Return whether some current was reached from both sides."""
    return any(not math.isnan(row.width_N) for row in results.over_current)


def judged_table(results: Characteristics) -> Table[JudgedValue]:
    """Return a row for each value that a limit of the rules is for."""
    return Table(columns_of(JudgedValue), results.judged, "Limits of the rules")


def work_table(results: Characteristics) -> Table[CycleWork]:
    """Return a row for each condition: measured work, and each simulation's with its difference, or what it implies."""
    alone = len(results.sources) == 1  # in a terminal there is room for one or the other
    implied = columns_of(CycleWork, "damping_Ns_m", "zero_width_N", "rebound_ratio")
    implied[1] = replace(implied[1], terminal_only=True)  # a table of its own on pages
    columns = columns_of(CycleWork, *CONDITION, "work_J")
    columns += _list_simulated(results, results.work, "work_J", "difference_J")
    columns += implied if alone else [replace(column, page_only=True) for column in implied[::2]]
    others = ", equivalent damping, hysteresis at zero speed, rebound over compression" if alone else ""
    return Table(columns, _select_measured(results.work), f"Work per cycle{others}.")


def zero_speed_table(results: Characteristics) -> Table[CycleWork]:
    """Return a row for each condition: the measured forces at zero speed."""
    columns = columns_of(CycleWork, *CONDITION, "zero_width_N", "zero_width_per_ms_N", "mid_force_N")
    return Table(columns, _select_measured(results.work))


def width_table(results: Characteristics) -> Table[tuple[ContinuousForce, ...]]:
    """Return the hysteresis width at WIDTH_SHARES of the peak speed; a row is a curve: its points at all SHARES."""
    size, rows = len(SHARES), results.continuous
    at = {share: int(abs(SHARES - share).argmin()) for share in WIDTH_SHARES}
    (width, force) = columns_of(ContinuousForce, "width_N", "force_N")
    columns = [_of_point(0, column) for column in columns_of(ContinuousForce, *CONDITION, "source", "direction")]
    columns += [_of_point(at[share], replace(width, heading=heading)) for share, heading in WIDTH_SHARES.items()]
    columns.append(_of_point(at[0.5], replace(force, heading="Force at 50\N{NO-BREAK SPACE}% [N]")))
    return Table(columns, [rows[k : k + size] for k in range(0, len(rows), size)])


def response_table(results: Characteristics) -> Table[ValveResponse]:
    """Return a row for each kind of step and source, times in ms."""
    names = ("from_A", "to_A", "change", "direction", "source", "steps", "speed_m_s", "force_change_N")
    times = ("dead_time_s", "time_constant_s", "time_63_s", "time_90_s", "rise_s", "settled_s", "overshoot", "dips")
    title = f"Response of the valve. {results.rules.step_sentence} \N{PLUS-MINUS SIGN}: half the 95 % interval."
    return Table(columns_of(ValveResponse, *names, *times), results.responses, title)


def recording_table(results: Characteristics) -> Table[RecordingFacts]:
    """Return a row for each recording: what the results rest on."""
    return Table(columns_of(RecordingFacts), results.recordings)


def omission_table(results: Characteristics) -> Table[Omission]:
    """Return a row for each reason why something in a recording was not used."""
    return Table(columns_of(Omission), [omission for omission in results.omissions if omission.recording != "all"])


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


def _of_point(number: int, column: Column[Any]) -> Column[Any]:
    """Return a column of one point of a curve."""
    return replace(column, text=lambda curve: column.text(curve[number]))


def _select_measured(rows: Sequence[OneRow]) -> list[OneRow]:
    return [row for row in rows if row.source == MEASURED]


def _list_simulated(results: Characteristics, rows: Sequence[Any], *names: str) -> list[Column[Any]]:
    """Return each simulation's value and difference; a terminal has room for the values of one simulation only."""

    def condition(row: Any) -> tuple[Any, ...]:
        return getattr(row, "current_A", 0.0), row.amplitude_m, row.frequency_Hz, getattr(row, "direction", "")

    def of_source(source: str, column: Column[Any]) -> Column[Any]:
        same = {condition(row): row for row in rows if row.source == source}
        return replace(column, text=lambda row: column.text(same[key]) if (key := condition(row)) in same else MISSING)

    columns, several = [], len(results.sources) > 2
    for source in results.sources[1:] if rows else ():
        value, difference = (row_fields(type(rows[0]))[name] for name in names)
        value = replace(value, heading=source, short="" if several else source, spread="")
        difference = replace(difference, short=f"{source} difference" if several else "difference")
        columns += [of_source(source, replace(value.column, head_css="as-is")), of_source(source, difference.column)]
    return columns
