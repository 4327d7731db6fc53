"""The candidates in a log: its columns, or its channels with their own times, and what tells the time of the rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ces_identify.proposal.candidate import Candidate
from ces_identify.proposal.words import read_meaning, split_words
from ces_identify.recordings.formats.log_file import LogTable, TimedLog
from ces_identify.recordings.log_import import read_times
from ces_identify.recordings.log_mapping import Column
from ces_identify.recordings.recording import Stamps, Values
from ces_identify.recordings.units import Unit, find_unit, split_unit
from ces_observer.errors import RecordingError

MIN_SAMPLES, MAX_USUAL_STEP_S = 3, 0.1
EPOCHS = {"s": 1e8, "ms": 1e11, "us": 1e14, "ns": 1e17}  # smallest numbers of times since 1970, from 1973 on
RATE_WORDS = frozenset({"fs", "rate", "hz", "frequency", "samplerate"})


@dataclass(frozen=True)
class LogCandidates:
    """The candidates by the key that a mapping uses; the time's column or the rate [Hz], both None if not needed.

    `time_text` says how the time is known, or is empty if it is not; `time_doubt` is what a person should check.
    """

    candidates: tuple[Candidate, ...]
    keys: dict[str, Column]
    time: Column | None = None
    rate: float | Column | None = None
    time_text: str = ""
    time_doubt: str = ""


@dataclass(frozen=True)
class _TableColumn:
    key: str | int
    values: Values
    unit: Unit | None
    name: str
    stated: str


def find_log_candidates(log: LogTable | TimedLog, rate: float | None) -> LogCandidates:
    """Return the candidates of an open log; `rate` [Hz] replaces the time of a table."""
    return _of_series(log) if isinstance(log, TimedLog) else _of_table(log, rate)


def _of_series(log: TimedLog) -> LogCandidates:
    found, keys = [], {}
    for series in log.read_all():
        if len(series.values) < MIN_SAMPLES or not np.isfinite(series.values).any() or series.label in keys:
            continue
        name, unit = split_unit(series.key or series.label)
        stated = find_unit(series.unit)
        where = "that the log states for it" if stated else "from its name" if unit else ""
        found.append(
            Candidate(series.label, (name,), series.stamps_ns, series.values, unit=stated or unit, stated=where)
        )
        keys[series.label] = Column(series.key or series.label, group=series.group)
    return LogCandidates(tuple(found), keys, time_text="the channels' own times")


def _of_table(table: LogTable, rate: float | None) -> LogCandidates:
    columns = _read_columns(table)
    time = None if rate else _find_time(table, columns)
    known_rate: float | Column | None = rate
    if time is None and rate is None:
        known_rate = _find_rate(columns)
    count = max((len(column.values) for column in columns), default=0)
    stamps = _stamps(table, time, known_rate, columns, count)
    keep = [c for c in columns if (time is None or c.key != time.key) and len(c.values) == len(stamps)]
    candidates = tuple(_candidate(c, stamps) for c in keep if np.isfinite(c.values).sum() >= MIN_SAMPLES)
    keys = {str(c.key): Column(c.key) for c in keep}
    doubt = "" if time is None else _doubt_time(table, time, stamps)
    return LogCandidates(candidates, keys, time, known_rate, _describe_time(time, known_rate), doubt)


def _doubt_time(table: LogTable, time: Column, stamps: Stamps) -> str:
    """Return why the unit of a time without one is doubtful, '' if it is not."""
    if not table.names:
        return f"time: column {time.key!r} by its numbers alone, the table has no names"
    usual = float(np.median(np.diff(stamps))) * 1e-9 if len(stamps) > 1 else 0.0
    if time.unit or usual < MAX_USUAL_STEP_S or table.stamps(time) is not None:
        return ""
    return f"time: column {time.key!r} states no unit; in seconds its steps are {usual:g} s (is it in ms, or a number?)"


def _read_columns(table: LogTable) -> list[_TableColumn]:
    """Return the columns that hold numbers, by name, or by number if the name is not unique."""
    found = []
    for i, name in enumerate(table.names or range(_width(table))):
        key = i if list(table.names).count(str(name)) > 1 or not table.names or not str(name) else str(name)
        try:
            values = table.column(key)
        except RecordingError:
            continue
        stated, (plain, unit) = find_unit(table.unit(key)), split_unit(str(name))
        where = "from the header" if stated else "from its name" if unit else ""
        found.append(_TableColumn(key, values, stated or unit, plain, where))
    return found


def _width(table: LogTable) -> int:
    """Return the number of columns of a table without names."""
    for width in range(256):
        try:
            table.column(width)
        except RecordingError as error:
            if "no column" in str(error):
                return width
    return 256


def _find_time(table: LogTable, columns: Sequence[_TableColumn]) -> Column | None:
    """Return the column of the time: dates and exact stamps first, then a time by name or unit that goes forward."""
    for c in columns:
        unit = _stated_time_unit(c) or _epoch_unit(c)
        column = Column(c.key, unit.scale, scaled=True, unit=unit.text) if unit else Column(c.key)
        if read_meaning((c.name,)).quantity == "time" and table.stamps(column) is not None:
            return column
    texts = [name for name in table.names if list(table.names).count(name) == 1]
    for name in texts:
        if not any(c.key == name for c in columns) and _holds_dates(table, name):
            return Column(name)
    rising = [c for c in columns if _goes_forward(c.values)]
    for c in sorted(rising, key=lambda c: _stated_time_unit(c) is None):
        unit = _stated_time_unit(c)
        if unit or read_meaning((c.name,)).quantity == "time" or split_words(c.name) == ("s",):
            unit = unit or _epoch_unit(c)
            return Column(c.key, unit.scale, scaled=True, unit=unit.text) if unit else Column(c.key)
    named = [c for c in columns if _is_named_time(c)]  # whose fault is reported when it is read
    first = [c for c in columns[:1] if not table.names and _goes_forward(c.values)]
    return next((Column(c.key) for c in (*named, *first)), None)


def _stated_time_unit(column: _TableColumn) -> Unit | None:
    return column.unit if column.unit is not None and column.unit.quantity == "time" else None


def _epoch_unit(column: _TableColumn) -> Unit | None:
    """Return the unit in which a time counts from 1970, by its size; None for a time that counts from the start."""
    first = float(column.values[0]) if len(column.values) else np.nan
    return next((find_unit(text) for text, low in EPOCHS.items() if low <= first < 1000.0 * low), None)


def _holds_dates(table: LogTable, name: str) -> bool:
    """Return whether a column holds dates; raises RecordingError for a bad one in a column that is named as a time."""
    try:
        return table.stamps(Column(name)) is not None
    except RecordingError:
        if read_meaning((split_unit(name)[0],)).quantity == "time":
            raise
        return False


def _is_named_time(column: _TableColumn) -> bool:
    """Return whether a column is called a time in full and moves, even if it does not go forward."""
    finite = column.values[np.isfinite(column.values)]
    return "time" in split_words(column.name) and len(finite) > 1 and bool(np.ptp(finite) > 0.0)


def _goes_forward(values: Values) -> bool:
    return (
        len(values) > 1
        and bool(np.isfinite(values).all())
        and bool((np.diff(values) >= 0.0).all())
        and bool(values[-1] > values[0])
    )


def _find_rate(columns: Sequence[_TableColumn]) -> Column | None:
    """Return the column that holds the rate, by its name and a constant number above 1."""
    for c in columns:
        finite = c.values[np.isfinite(c.values)]
        words = set(split_words(str(c.key)))
        if len(finite) and words & RATE_WORDS and np.ptp(finite) == 0.0 and finite[0] > 1.0:
            return Column(c.key)
    return None


def _stamps(
    table: LogTable, time: Column | None, rate: float | Column | None, columns: Sequence[_TableColumn], count: int
) -> Stamps:
    if time is not None:
        return read_times(table, time, count)
    value = rate if isinstance(rate, float) else 1000.0
    if isinstance(rate, Column):
        value = next(float(c.values[np.isfinite(c.values)][0]) for c in columns if c.key == rate.key)
    return np.asarray(np.rint(np.arange(count) * (1e9 / value)).astype(np.int64))


def _describe_time(time: Column | None, rate: float | Column | None) -> str:
    if time is not None:
        return f"time from {time.key!r} [{time.unit or 's'}]"
    if isinstance(rate, Column):
        return f"rate from {rate.key!r}"
    return f"rate {rate:g} Hz" if rate else ""


def _candidate(column: _TableColumn, stamps: Stamps) -> Candidate:
    there = np.isfinite(column.values)
    return Candidate(
        str(column.key), (column.name,), stamps[there], column.values[there], unit=column.unit, stated=column.stated
    )
