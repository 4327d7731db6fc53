"""The time of a table's rows: which column holds it, in which unit, and what a person should check about it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ces_data.findings import rate_between_pauses
from ces_data.limits import TableLimits
from ces_data.logs.log_file import LogTable
from ces_data.logs.log_import import is_digital_clock
from ces_data.logs.log_mapping import LogColumn
from ces_data.mapping.rating import Candidate, read_meaning, split_words
from ces_data.recording import Stamps, Values
from ces_data.units import Unit, find_unit, split_unit
from ces_observer.errors import RecordingError

EPOCHS = {"s": 1e8, "ms": 1e11, "us": 1e14, "ns": 1e17}  # smallest numbers of times since 1970, from 1973 on
DATE_WORDS = frozenset({"date", "datum", "datetime"})
TIME_AXES = (("s",), ("x", "value"), ("x", "axis"))  # `X_Value` is LabVIEW's, `XAxis` ControlDesk's
RATE_WORDS = frozenset({"fs", "rate", "hz", "frequency", "samplerate"})
SAMPLING_WORDS = frozenset({"fs", "samplerate", "sample", "sampling", "abtastrate"})  # of a rate that is no test's
PERIOD_WORDS = frozenset({"ts", "dt", "tsample", "sampletime", "samplingtime"})
TIME_UNITS = {  # by words in names
    **dict.fromkeys(("millis", "millisec", "msec", "ms"), "ms"),
    **dict.fromkeys(("micros", "microsec", "usec", "us"), "us"),
    **dict.fromkeys(("min", "minutes"), "min"),
    **dict.fromkeys(("h", "hours"), "h"),
}
UNIT_S = {"ms": 1e-3, "us": 1e-6}
CALENDARS = (  # times as numbers from low to high that count from a date: scale * number + offset is s since 1970
    (2e4, 8e4, 86_400.0, -25_569 * 86_400.0, "days since 30 December 1899, as Excel counts"),
    (7e5, 8e5, 86_400.0, -719_529 * 86_400.0, "days since the year 0, as MATLAB counts"),
    (3e9, 4.5e9, 1.0, -2_082_844_800.0, "s since 1904, as LabVIEW counts"),
)


@dataclass(frozen=True)
class TableColumn:
    """A column of numbers: its key in a mapping, its name without the unit, and where the unit is stated."""

    key: str | int
    values: Values
    unit: Unit | None
    name: str
    stated: str
    contrary: str = ""  # the unit in its name, if the file states another

    @property
    def label(self) -> str:
        """The name for people; one that only its number distinguishes has both."""
        number = f"column {self.key}" + (f" ({self.name})" if self.name else "")
        return self.key if isinstance(self.key, str) else number

    @property
    def time_unit(self) -> Unit | None:
        """The stated unit if it is one of times."""
        return self.unit if self.unit is not None and self.unit.quantity == "time" else None

    @property
    def named_time(self) -> bool:
        """Whether the name says that it is a time."""
        return read_meaning((self.name,)).quantity == "time"

    @cached_property
    def goes_forward(self) -> bool:
        """Whether the numbers rise, and never fall."""
        if len(self.values) < 2 or not np.isfinite(self.values).all():
            return False
        return bool((np.diff(self.values) >= 0.0).all() and self.values[-1] > self.values[0])

    @cached_property
    def steps_s(self) -> float:
        """Median step of the numbers, in seconds if that is their unit."""
        return float(np.median(np.diff(self.values))) if len(self.values) > 1 else 0.0

    @property
    def is_whole(self) -> bool:
        """Whether all numbers are whole, as those of a clock that counts ms."""
        return bool((self.values == np.rint(self.values)).all())

    @property
    def is_even(self) -> bool:
        """Whether the numbers rise evenly, by other steps than those that count rows."""
        steps = np.diff(self.values)
        even = np.abs(steps - self.steps_s) < 0.5 * self.steps_s
        return bool(self.goes_forward and even.mean() > TableLimits.EVEN_SHARE and not (steps == 1.0).all())

    def as_time(self) -> LogColumn:
        """Return the column as a time in its stated unit, or in that in which it counts from 1970 by its size."""
        unit = self.time_unit or find_unit(next((TIME_UNITS[w] for w in split_words(self.name) if w in TIME_UNITS), ""))
        if unit is None and len(self.values):
            fits = (text for text, low in EPOCHS.items() if low <= float(self.values[0]) < 1000.0 * low)
            unit = find_unit(next(fits, ""))
        if unit is None and self.steps_s > TableLimits.MAX_STEP_S and self.is_whole and self.steps_s != 1.0:
            unit = find_unit(next((u for u in ("ms", "us") if self.steps_s * UNIT_S[u] <= TableLimits.MAX_STEP_S), ""))
        return LogColumn(self.key, unit=unit.text if unit else "")


def find_time(table: LogTable, columns: Sequence[TableColumn], unread: dict[str, str]) -> LogColumn | None:
    """Return the column of the time: dates and exact stamps first, then a time by name or unit that goes forward."""
    dates = _find_dates(table, columns, unread)
    if not is_coarse(table.stamps(dates)) if dates else "time" in unread:
        return dates
    if counted := next(filter(None, map(_find_calendar, columns)), None):
        return counted
    lengths = Counter(len(c.values) for c in columns if len(c.values) >= TableLimits.MIN_SAMPLES)
    rows = lengths.most_common(1)[0][0] if lengths else 0
    as_long = [c for c in columns if len(c.values) == rows]  # others cannot be the time of the rows
    forward = [c for c in as_long if c.goes_forward]
    for c in sorted(forward, key=lambda c: (is_coarse(c.values), c.time_unit is None)):
        if c.time_unit or c.named_time or split_words(c.name) in (*TIME_AXES, *((unit,) for unit in UNIT_S)):
            return dates if dates and is_coarse(c.values) else c.as_time()
    for c in [] if dates else as_long:  # whose fault is reported when it is read
        finite = c.values[np.isfinite(c.values)]
        words = split_words(c.name)
        named = c.time_unit or c.named_time or "time" in words or (table.breaks and words in TIME_AXES[1:])
        named = named or words in [(unit,) for unit in UNIT_S]
        if named and len(finite) > 1 and np.ptp(finite) > 0.0:
            return c.as_time()
    if dates or not table.names:
        return dates or next((LogColumn(c.key) for c in columns[:1] if c.goes_forward), None)
    return _find_even(as_long) if not any(map(holds_rate, columns)) else None


def is_coarse(times: Values | Stamps | None) -> bool:
    """Return whether times that go forward are the same in several rows, as those that are cut to seconds."""
    if times is None or not len(times):
        return False
    return len(times) > TableLimits.MAX_ROWS_PER_TIME * (1 + int(np.count_nonzero(np.diff(times))))


def _find_even(columns: Sequence[TableColumn]) -> LogColumn | None:
    """Return the only column that rises evenly and says nothing else, as a time by its numbers alone."""
    even = [c for c in columns if c.is_even and c.unit is None and not read_meaning((c.name,)).quantity]
    return even[0].as_time() if len(even) == 1 else None


def _find_dates(table: LogTable, columns: Sequence[TableColumn], unread: dict[str, str]) -> LogColumn | None:
    """Return the first column of dates or of exact stamps; notes in `unread` why one that is named so has none."""
    for c in columns:
        if c.named_time and table.stamps(c.as_time()) is not None:
            return c.as_time()
    names = list(table.names)
    for name in names:
        if names.count(name) > 1 or any(c.key == name for c in columns):
            continue
        try:
            if table.stamps(LogColumn(name)) is not None:
                return LogColumn(name)
        except RecordingError as error:
            if read_meaning((split_unit(name)[0],)).quantity == "time" or set(split_words(name)) & DATE_WORDS:
                unread["time"] = without_path(error, table)
    return None


def _find_calendar(column: TableColumn) -> LogColumn | None:
    """Return a column whose numbers count from a date as some program does, None for any other."""
    dated = set(split_words(column.name)) & DATE_WORDS or column.named_time
    if not dated or not column.goes_forward or (column.unit and column.unit.text not in ("d", "s")):
        return None
    for low, high, scale, offset, _ in CALENDARS:
        if low <= column.values[0] and column.values[-1] < high:
            step_s = scale * float(np.median(np.diff(column.values)))
            if step_s < TableLimits.MAX_STEP_S and not (scale > 1.0 and np.ptp(column.values) > 31.0):
                return LogColumn(column.key, given_scale=scale, given_offset=offset)
    return None


def holds_rate(column: TableColumn) -> bool:
    """Return whether a column holds the rate, by its name and a constant number above 1."""
    finite = column.values[np.isfinite(column.values)]
    named = set(split_words(str(column.key))) & RATE_WORDS
    return bool(len(finite) and named and np.ptp(finite) == 0.0 and finite[0] > 1.0)


def read_period(column: TableColumn) -> float | None:
    """Return the rate [Hz] by the one number of a column that is named like a sampling time, None if it is none."""
    named = set(split_words(str(column.key).rpartition(".")[2])) & PERIOD_WORDS
    period_s = float(column.values[0]) if named and len(column.values) == 1 else 0.0
    return 1.0 / period_s if TableLimits.MIN_STEP_S <= period_s <= TableLimits.MAX_STEP_S else None


def describe_time(table: LogTable, time: LogColumn | None, rate: float | LogColumn | None) -> str:
    """Return how the time of the rows is known, '' if it is not."""
    if time is None:
        return f"rate from {rate.key!r}" if isinstance(rate, LogColumn) else f"rate {rate:g} Hz" if rate else ""
    if time.key == "":
        return "time from the first column"
    plain = time.key in table.names and table.stamps(time) is None and not time.scaled
    if plain and is_digital_clock(table.column(time.key)):
        return f"time from {time.key!r} [HHMMSS]"
    form = time.unit or ("s" if table.stamps(time) is None else "date or time of day")
    if time.offset:
        form = next(text for *_, offset, text in CALENDARS if offset == time.offset)
    return f"time from {time.key!r} [{form}]"


def doubt_time(table: LogTable, time: LogColumn, stamps: Stamps, candidates: Sequence[Candidate]) -> str:
    """Return why the unit of a time without one is doubtful, or why its steps are; '' if neither is."""
    where = f"time: column {time.key!r}"
    if not table.names:
        return f"{where} by its numbers alone, the table has no names"
    usual = float(np.median(np.diff(stamps))) * 1e-9 if len(stamps) > 1 else 0.0
    counts = ((len(c.stamps_ns), 1 + int(np.count_nonzero(np.diff(c.stamps_ns)))) for c in candidates)
    rows, different = min(counts, default=(0, 0), key=lambda count: count[0] / count[1])
    if rows > TableLimits.MAX_ROWS_PER_TIME * different:
        return (
            f"{where} has only {different} different times in {rows} rows, too coarse to tell one row from the next "
            "(or are rows repeated?); give --rate HZ"
        )
    return _doubt_unit(table, time, where, usual)


def _doubt_unit(table: LogTable, time: LogColumn, where: str, usual_s: float) -> str:
    """Return why the unit of a time is doubtful: a name that says none, or steps that no logger has."""
    words = split_words(split_unit(str(time.key))[0])
    stated = find_unit(table.unit(time.key)) or split_unit(str(time.key))[1] or {*words} & TIME_UNITS.keys()
    if stated or table.stamps(time) is not None or time.given_scale is not None or not usual_s:
        return ""
    if read_meaning((str(time.key),)).quantity != "time" and "time" not in words and words not in TIME_AXES:
        return f"{where} by its numbers alone, which rise evenly; taken as {time.unit or 's'}"
    if time.unit in UNIT_S and float(table.column(time.key)[0]) < EPOCHS[time.unit]:
        steps = usual_s / UNIT_S[time.unit]
        return f"{where} states no unit; taken as {time.unit}, because in seconds its steps would be {steps:g} s"
    if time.unit or TableLimits.MIN_STEP_S <= usual_s < TableLimits.MAX_STEP_S:
        return ""
    other = "in hours or days" if usual_s < TableLimits.MIN_STEP_S else "in ms, or a number"
    return f"{where} states no unit; in seconds its steps are {usual_s:g} s (is it {other}?)"


def doubt_pairs(columns: Sequence[TableColumn], time: LogColumn) -> str:
    """Return that signals have times of their own, as in `t_x, x, t_F, F`, '' if one time is that of all."""
    chosen = next((c for c in columns if c.key == time.key), None)
    if chosen is None:
        return ""
    are_times = [(c.time_unit is not None or c.named_time) and c.goes_forward for c in columns]
    times = chosen.values * (chosen.time_unit.scale if chosen.time_unit else 1.0)
    for c, is_time, after_time in zip(columns, are_times, [True, *are_times], strict=False):
        if c is chosen or not is_time or after_time or c.steps_s == 0.0:  # a time that is cut to whole seconds
            continue
        others = c.values * (c.time_unit.scale if c.time_unit else 1.0)
        if others.shape == times.shape:  # the same time, or one of another clock, is no time of other samples
            step, apart = float(np.median(np.diff(times))), np.abs(others - times)
            if apart[0] >= TableLimits.MAX_APART * step or apart.max() <= TableLimits.MIN_APART * step:
                continue
        return (
            f"time: columns {chosen.key!r} and {c.key!r} are both times and differ; a table has one time for all its "
            "columns (save each signal with its own time as MAT, JSON or MDF, or one time with blank cells where a "
            "signal has no sample)"
        )
    return ""


def doubt_rate(table: LogTable, time: LogColumn, stamps: Stamps, columns: Sequence[TableColumn]) -> str:
    """Return that the times contradict the rate that a column or the file's header states, '' if they do not."""
    column = next((c for c in columns if holds_rate(c) and set(split_words(str(c.key))) & SAMPLING_WORDS), None)
    stated_Hz = table.stated_Hz if column is None else float(np.nanmax(column.values))
    rate_Hz = rate_between_pauses(stamps)
    if not stated_Hz or not rate_Hz or abs(rate_Hz / stated_Hz - 1.0) <= TableLimits.RATE_TOLERANCE:
        return ""
    where = "the header" if column is None else f"column {column.key!r}"
    return f"time: {time.key!r} gives {rate_Hz:.4g} Hz, and {where} states {stated_Hz:g} Hz; which is right?"


def without_path(error: RecordingError, table: LogTable) -> str:
    """Return an error's text without the file's name, which the import's own message begins with."""
    text = str(error).removeprefix(f"{table.path}:").strip()
    return f"line {text}" if text[:1].isdigit() else text
