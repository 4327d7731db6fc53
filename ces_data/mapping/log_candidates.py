"""The candidates in a log: its columns, or its channels with their own times, and what tells the time of the rows."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ces_data.logs.log_file import LogTable, TimedLog
from ces_data.logs.log_import import read_times
from ces_data.logs.log_mapping import Column
from ces_data.mapping.candidates import Candidate
from ces_data.mapping.rating import read_meaning, split_words
from ces_data.recording import Stamps, Values
from ces_data.units import QUANTITIES, Unit, find_unit, split_unit
from ces_observer.errors import RecordingError

MIN_SAMPLES, MAX_USUAL_STEP_S = 3, 0.1
MAX_COLUMNS = 256  # of a table without names
EPOCHS = {"s": 1e8, "ms": 1e11, "us": 1e14, "ns": 1e17}  # smallest numbers of times since 1970, from 1973 on
DATE_WORDS = frozenset({"date", "datum", "datetime"})
MIN_STEP_S, MAX_ROWS_PER_TIME = 1e-6, 1.5  # of a time as logged
MIN_APART, MAX_APART = 0.05, 100.0  # steps between two times in a row: those of two signals, or two clocks
DIALLED_PATH = re.compile(r"(Platform\(\)://)?Model Root/")  # before each name in ControlDesk's exports
TIME_AXES = (("s",), ("x", "value"), ("x", "axis"))  # `X_Value` is LabVIEW's, `XAxis` ControlDesk's
ANY = ""  # key of what may be any signal
RATE_WORDS = frozenset({"fs", "rate", "hz", "frequency", "samplerate"})


@dataclass(frozen=True)
class _Calendar:
    """Times as numbers that count from a date: `scale * number + offset` are seconds since 1970."""

    low: float
    high: float
    scale: float
    offset: float
    text: str


CALENDARS = (
    _Calendar(2e4, 8e4, 86_400.0, -25_569 * 86_400.0, "days since 30 December 1899, as Excel counts"),
    _Calendar(7e5, 8e5, 86_400.0, -719_529 * 86_400.0, "days since the year 0, as MATLAB counts"),
    _Calendar(3e9, 4.5e9, 1.0, -2_082_844_800.0, "s since 1904, as LabVIEW counts"),
)


@dataclass(frozen=True)
class LogCandidates:
    """The candidates by the key that a mapping uses; the time's column or the rate [Hz], both None if not needed.

    `time_text` says how the time is known, or is empty if it is not; `time_doubt` is what a person should check.
    `unread` are the columns that are no candidates although their names or units say what they are, by that signal
    (or `time`), each with the reason; under `ANY` is one that may be any signal, such as a MATLAB object.
    """

    candidates: tuple[Candidate, ...]
    keys: dict[str, Column]
    time: Column | None = None
    rate: float | Column | None = None
    time_text: str = ""
    time_doubt: str = ""
    unread: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class _TableColumn:
    """A column of numbers: its key in a mapping, its name without the unit, and where the unit is stated."""

    key: str | int
    values: Values
    unit: Unit | None
    name: str
    stated: str


def find_log_candidates(log: LogTable | TimedLog, rate: float | None) -> LogCandidates:
    """Return the candidates of an open log; `rate` [Hz] replaces the time of a table."""
    return _of_series(log) if isinstance(log, TimedLog) else _of_table(log, rate)


def _of_series(log: TimedLog) -> LogCandidates:
    found, keys, unread = [], {}, {}
    for series in log.read_all():
        if series.label in keys:
            continue
        if len(series.values) < MIN_SAMPLES or not np.isfinite(series.values).any():
            reason = f"{series.label!r} has {np.isfinite(series.values).sum()} samples"
            unread.update(dict.fromkeys(_meanings(series.key or series.label), reason))
            continue
        name, unit = split_unit(DIALLED_PATH.sub("", series.key or series.label))
        stated = find_unit(series.unit)
        where = "that the log states for it" if stated else "from its name" if unit else ""
        found.append(
            Candidate(series.label, (name,), series.stamps_ns, series.values, unit=stated or unit, stated=where)
        )
        keys[series.label] = Column(series.key or series.label, group=series.group)
    return LogCandidates(tuple(found), keys, time_text="the channels' own times", unread=unread)


def _of_table(table: LogTable, rate: float | None) -> LogCandidates:
    columns, unread = _read_columns(table)
    time = None if rate else _find_time(table, columns, unread)
    known_rate: float | Column | None = rate
    if time is None and rate is None:
        known_rate = _find_rate(columns)
    count = max((len(column.values) for column in columns), default=0)
    stamps = _stamps(table, time, known_rate, columns, count)
    keep = [c for c in columns if (time is None or c.key != time.key) and len(c.values) == len(stamps)]
    candidates = tuple(_candidate(c, stamps) for c in keep if np.isfinite(c.values).sum() >= MIN_SAMPLES)
    keys = {_label(c): Column(c.key) for c in keep}
    for column in columns:
        if len(column.values) != len(stamps):
            reason = f"{column.key!r} has {len(column.values)} values for {len(stamps)} rows"
            unread.update(dict.fromkeys(_meanings(str(column.key)), reason))
    for name, reason in table.unread.items():
        unread.update(dict.fromkeys((ANY, *_meanings(name)), reason))
    doubt = "" if time is None else _doubt_time(table, time, stamps, candidates) or _doubt_pairs(columns, time)
    return LogCandidates(candidates, keys, time, known_rate, _describe_time(table, time, known_rate), doubt, unread)


def _meanings(name: str) -> Iterator[str]:
    """Yield the signals that a column of this name would be, by its words or its unit."""
    plain, unit = split_unit(name)
    yield from (signal for signal, kinds in QUANTITIES.items() if unit is not None and unit.quantity in kinds)
    if quantity := read_meaning((plain,)).quantity:
        yield quantity


def _doubt_pairs(columns: Sequence[_TableColumn], time: Column) -> str:
    """Return that signals have times of their own, as in `t_x, x, t_F, F`, '' if one time is that of all."""
    first = next((c for c in columns if c.key == time.key), None)
    if first is None:
        return ""
    own = [c for before, c in pairwise(columns) if c is not first and _is_time(c) and not _is_time(before)]
    times = _in_seconds(first)

    def is_other(column: _TableColumn) -> bool:  # of other samples: not the same time, and not one of another clock
        others = _in_seconds(column)
        if others.shape != times.shape:
            return True
        step = float(np.median(np.diff(times)))
        return bool(abs(others[0] - times[0]) < MAX_APART * step and np.abs(others - times).max() > MIN_APART * step)

    other = next(filter(is_other, own), None)
    if other is None:
        return ""
    return (
        f"time: columns {first.key!r} and {other.key!r} are both times and differ; a table has one time for all its "
        "columns (save each signal with its own time as MAT, JSON or MDF, or one time with blank cells where a signal "
        "has no sample)"
    )


def _in_seconds(column: _TableColumn) -> Values:
    unit = _stated_time_unit(column)
    return column.values if unit is None else unit.scale * column.values


def _is_time(column: _TableColumn) -> bool:
    """Return whether a column is named like a time, or has its unit, and goes forward."""
    named = _stated_time_unit(column) is not None or read_meaning((column.name,)).quantity == "time"
    return named and _goes_forward(column.values)


def _doubt_time(table: LogTable, time: Column, stamps: Stamps, candidates: Sequence[Candidate]) -> str:
    """Return why the unit of a time without one is doubtful, or why its steps are; '' if neither is."""
    if not table.names:
        return f"time: column {time.key!r} by its numbers alone, the table has no names"
    usual = float(np.median(np.diff(stamps))) * 1e-9 if len(stamps) > 1 else 0.0
    counts = ((len(c.stamps_ns), 1 + int(np.count_nonzero(np.diff(c.stamps_ns)))) for c in candidates)
    rows, different = min(counts, default=(0, 0), key=lambda count: count[0] / count[1])
    if rows > MAX_ROWS_PER_TIME * different:
        return (
            f"time: column {time.key!r} has only {different} different times in {rows} rows, too coarse to tell one "
            "row from the next (or are rows repeated?); give --rate HZ"
        )
    if 0.0 < usual < MIN_STEP_S and not time.unit and not time.scaled and table.stamps(time) is None:
        return (
            f"time: column {time.key!r} states no unit; in seconds its steps are {usual:g} s (is it in hours or days?)"
        )
    if time.unit or time.scaled or usual < MAX_USUAL_STEP_S or table.stamps(time) is not None:
        return ""
    return f"time: column {time.key!r} states no unit; in seconds its steps are {usual:g} s (is it in ms, or a number?)"


def _read_columns(table: LogTable) -> tuple[list[_TableColumn], dict[str, str]]:
    """Return the columns that hold numbers, by name, or by number if the name is not unique; and why not the others."""
    found: list[_TableColumn] = []
    unread: dict[str, str] = {}
    for i, name in enumerate(table.names or range(min(table.width, MAX_COLUMNS))):
        key = i if list(table.names).count(str(name)) > 1 or not table.names or not str(name) else str(name)
        try:
            values = table.column(key)
        except RecordingError as error:
            unread.update({signal: _without_path(error, table) for signal in _meanings(str(name))})
            continue
        stated, (plain, unit) = find_unit(table.unit(key)), split_unit(DIALLED_PATH.sub("", str(name)))
        where = "from the header" if stated else "from its name" if unit else ""
        found.append(_TableColumn(key, values, stated or unit, plain, where))
    return found, unread


def _without_path(error: RecordingError, table: LogTable) -> str:
    """Return an error's text without the file's name, which the import's own message begins with."""
    text = str(error).removeprefix(f"{table.path}:").strip()
    return f"line {text}" if text[:1].isdigit() else text


def _find_time(table: LogTable, columns: Sequence[_TableColumn], unread: dict[str, str]) -> Column | None:
    """Return the column of the time: dates and exact stamps first, then a time by name or unit that goes forward.

    Adds to `unread` why a column of dates that is named as a time cannot be read.
    """
    for c in columns:
        unit = _stated_time_unit(c) or _epoch_unit(c)
        column = Column(c.key, unit.scale, scaled=True, unit=unit.text) if unit else Column(c.key)
        if read_meaning((c.name,)).quantity == "time" and table.stamps(column) is not None:
            return column
    texts = [name for name in table.names if list(table.names).count(name) == 1]
    for name in texts:
        if not any(c.key == name for c in columns) and _holds_dates(table, name, unread):
            return Column(name)
    if "time" in unread:
        return None
    if counted := next((found for c in columns if (found := _find_calendar(c))), None):
        return counted
    rising = [c for c in columns if _goes_forward(c.values)]
    for c in sorted(rising, key=lambda c: _stated_time_unit(c) is None):
        unit = _stated_time_unit(c)
        if unit or read_meaning((c.name,)).quantity == "time" or split_words(c.name) in TIME_AXES:
            unit = unit or _epoch_unit(c)
            return Column(c.key, unit.scale, scaled=True, unit=unit.text) if unit else Column(c.key)
    named = [  # whose fault is reported when it is read
        c
        for c in columns
        if "time" in split_words(c.name) and len(f := c.values[np.isfinite(c.values)]) > 1 and np.ptp(f) > 0.0
    ]
    first = [c for c in columns[:1] if not table.names and _goes_forward(c.values)]
    return next((Column(c.key) for c in (*named, *first)), None)


def _find_calendar(column: _TableColumn) -> Column | None:
    """Return a column whose numbers count from a date as some program does, None for any other."""
    dated = set(split_words(column.name)) & DATE_WORDS or read_meaning((column.name,)).quantity == "time"
    if not dated or not _goes_forward(column.values) or (column.unit and column.unit.text not in ("d", "s")):
        return None
    for calendar in CALENDARS:
        if calendar.low <= column.values[0] and column.values[-1] < calendar.high:
            step_s = calendar.scale * float(np.median(np.diff(column.values)))
            if step_s < MAX_USUAL_STEP_S and not (calendar.scale > 1.0 and np.ptp(column.values) > 31.0):
                return Column(column.key, calendar.scale, calendar.offset, scaled=True)
    return None


def _stated_time_unit(column: _TableColumn) -> Unit | None:
    return column.unit if column.unit is not None and column.unit.quantity == "time" else None


def _epoch_unit(column: _TableColumn) -> Unit | None:
    """Return the unit in which a time counts from 1970, by its size; None for a time that counts from the start."""
    first = float(column.values[0]) if len(column.values) else np.nan
    return next((find_unit(text) for text, low in EPOCHS.items() if low <= first < 1000.0 * low), None)


def _holds_dates(table: LogTable, name: str, unread: dict[str, str]) -> bool:
    """Return whether a column holds dates; one that is named as a time and has a bad one is noted in `unread`."""
    try:
        return table.stamps(Column(name)) is not None
    except RecordingError as error:
        if read_meaning((split_unit(name)[0],)).quantity == "time" or set(split_words(name)) & DATE_WORDS:
            unread["time"] = _without_path(error, table)
        return False


def _goes_forward(values: Values) -> bool:
    if len(values) < 2 or not np.isfinite(values).all():
        return False
    return bool((np.diff(values) >= 0.0).all() and values[-1] > values[0])


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


def _describe_time(table: LogTable, time: Column | None, rate: float | Column | None) -> str:
    if time is None:
        return f"rate from {rate.key!r}" if isinstance(rate, Column) else f"rate {rate:g} Hz" if rate else ""
    if time.key == "":
        return "time from the first column"
    form = time.unit or ("s" if table.stamps(time) is None else "date or time of day")
    if time.offset:
        form = next(calendar.text for calendar in CALENDARS if calendar.offset == time.offset)
    return f"time from {time.key!r} [{form}]"


def _label(column: _TableColumn) -> str:
    """Return a column's name for people; one that only its number distinguishes has both."""
    if isinstance(column.key, str):
        return column.key
    return f"column {column.key} ({column.name})" if column.name else f"column {column.key}"


def _candidate(column: _TableColumn, stamps: Stamps) -> Candidate:
    there = np.isfinite(column.values)
    stamps, values = (stamps, column.values) if there.all() else (stamps[there], column.values[there])
    return Candidate(_label(column), (column.name,), stamps, values, unit=column.unit, stated=column.stated)
