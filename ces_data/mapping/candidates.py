"""The candidates in bags, and in a log: its columns, or its channels with their own times, and the time of the rows."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from ces_data.bags.fields import FieldSeries, read_fields
from ces_data.limits import TableLimits
from ces_data.logs.log_file import LogTable, TimedLog
from ces_data.logs.log_import import TableClock, part_blocks, read_times
from ces_data.logs.log_mapping import LogColumn
from ces_data.mapping.rating import Candidate, read_meaning, split_words
from ces_data.recording import Stamps, Values
from ces_data.units import QUANTITIES, Unit, find_unit, split_unit
from ces_observer.errors import RecordingError

MAX_COLUMNS = 256  # of a table without names
EPOCHS = {"s": 1e8, "ms": 1e11, "us": 1e14, "ns": 1e17}  # smallest numbers of times since 1970, from 1973 on
DATE_WORDS = frozenset({"date", "datum", "datetime"})
DIALLED_PATH = re.compile(r"(Platform\(\)://)?Model Root/")  # before each name in ControlDesk's exports
TIME_AXES = (("s",), ("x", "value"), ("x", "axis"))  # `X_Value` is LabVIEW's, `XAxis` ControlDesk's
BETWEEN_BAGS_NS = 10_000_000_000
ANY = ""  # key of what may be any signal
RATE_WORDS = frozenset({"fs", "rate", "hz", "frequency", "samplerate"})
CALENDARS = (  # times as numbers from low to high that count from a date: scale * number + offset is s since 1970
    (2e4, 8e4, 86_400.0, -25_569 * 86_400.0, "days since 30 December 1899, as Excel counts"),
    (7e5, 8e5, 86_400.0, -719_529 * 86_400.0, "days since the year 0, as MATLAB counts"),
    (3e9, 4.5e9, 1.0, -2_082_844_800.0, "s since 1904, as LabVIEW counts"),
)


@dataclass(frozen=True)
class LogCandidates:
    """The candidates by the key that a mapping uses; the time's column or the rate [Hz], both None if not needed.

    `time_text` says how the time is known, or is empty if it is not; `time_doubt` is what a person should check.
    `unread` are the columns that are no candidates although their names or units say what they are, by that signal
    (or `time`), each with the reason; under `ANY` is one that may be any signal, such as a MATLAB object.
    """

    candidates: tuple[Candidate, ...]
    keys: dict[str, LogColumn]
    time: LogColumn | None = None
    rate: float | LogColumn | None = None
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

    def as_time(self) -> LogColumn:
        """Return the column as a time in its stated unit, or in that in which it counts from 1970 by its size."""
        unit = self.time_unit
        if unit is None and len(self.values):
            fits = (text for text, low in EPOCHS.items() if low <= float(self.values[0]) < 1000.0 * low)
            unit = find_unit(next(fits, ""))
        return LogColumn(self.key, unit=unit.text if unit else "")


def find_bag_candidates(paths: Sequence[Path]) -> tuple[tuple[Candidate, ...], dict[str, str]]:
    """Return the candidates in all bags, joined in time, and why topics were skipped; raises RecordingError if none."""
    bags = [read_fields(path) for path in paths]
    series = [{(s.topic, s.type, s.field): s for s in bag.series} for bag in bags]
    common = [key for key in series[0] if all(key in fields for fields in series)]
    if not common:
        names = ", ".join(str(path) for path in paths)
        raise RecordingError(f"{names}: no numbers in {'any topic' if len(paths) == 1 else 'a topic that all have'}")
    offsets, end = [], 0
    for bag in bags:
        first = min(int(fields.stamps_ns.min()) for fields in bag.series)
        last = max(int(fields.stamps_ns.max()) for fields in bag.series)
        offsets.append(end - first)
        end += last - first + BETWEEN_BAGS_NS
    keys = sorted(common, key=lambda key: key[0])  # by topic; within a message as its fields come
    candidates = tuple(_join([fields[key] for fields in series], offsets) for key in keys)
    return candidates, {name: why for bag in bags for name, why in bag.skipped.items()}


def _join(parts: Sequence[FieldSeries], offsets: Sequence[int]) -> Candidate:
    """Return the candidate of a field, the stamps of each bag moved by its offset [ns]."""
    sample = parts[0]
    field_name, unit = split_unit(sample.field.replace("[", "_").replace("]", ""))
    topic_name, topic_unit = split_unit(sample.topic)
    where = "from the field's name" if unit else "from the topic's name"
    return Candidate(
        label=f"{sample.topic} {sample.field}",
        names=(field_name, topic_name, sample.type.rpartition("/")[2]),
        stamps_ns=np.concatenate([part.stamps_ns + offset for part, offset in zip(parts, offsets, strict=True)]),
        values=np.concatenate([part.values for part in parts]),
        kind=sample.type,
        topic=sample.topic,
        field=sample.field,
        unit=unit or topic_unit,
        stated=where if unit or topic_unit else "",
    )


def find_log_candidates(log: LogTable | TimedLog, rate: float | None) -> LogCandidates:
    """Return the candidates of an open log; `rate` [Hz] replaces the time of a table."""
    return _of_series(log) if isinstance(log, TimedLog) else _of_table(log, rate)


def _of_series(log: TimedLog) -> LogCandidates:
    candidates, keys, unread = [], {}, {}
    for series in log.read_all():
        if series.label in keys:
            continue
        key = series.key or series.label
        if len(series.values) < TableLimits.MIN_SAMPLES or not np.isfinite(series.values).any():
            reason = f"{series.label!r} has {np.isfinite(series.values).sum()} samples"
            unread.update(dict.fromkeys(_meanings(key), reason))
            continue
        name, unit = split_unit(DIALLED_PATH.sub("", key))
        stated = find_unit(series.unit)
        how = "that the log states for it" if stated else "from its name" if unit else ""
        candidates.append(
            Candidate(series.label, (name,), series.stamps_ns, series.values, unit=stated or unit, stated=how)
        )
        keys[series.label] = LogColumn(key, group=series.group)
    return LogCandidates(tuple(candidates), keys, time_text="the channels' own times", unread=unread)


def _of_table(table: LogTable, rate: float | None) -> LogCandidates:
    columns, unread = _read_columns(table)
    time = None if rate else _find_time(table, columns, unread)
    counted = None if time or rate is not None else next(filter(_holds_rate, columns), None)
    known_rate = rate if counted is None else LogColumn(counted.key)
    count = max((len(column.values) for column in columns), default=0)
    if time is None:
        rate_Hz = rate or (1000.0 if counted is None else float(counted.values[np.isfinite(counted.values)][0]))
        stamps = np.rint(np.arange(count) * (1e9 / rate_Hz)).astype(np.int64)
        stamps = part_blocks(stamps, table.breaks, TableClock())
    else:
        stamps = read_times(table, time, count)
    candidates, keys = [], {}
    for c in columns:
        there = np.isfinite(c.values)
        if len(there) != len(stamps):
            reason = f"{c.key!r} has {len(there)} values for {len(stamps)} rows"
            unread.update(dict.fromkeys(_meanings(str(c.key)), reason))
        elif time is None or c.key != time.key:
            keys[c.label] = LogColumn(c.key)
            if there.sum() < TableLimits.MIN_SAMPLES:
                unread.update(dict.fromkeys(_meanings(str(c.key)), f"{c.key!r} has {there.sum()} samples"))
            else:
                values = (stamps, c.values) if there.all() else (stamps[there], c.values[there])
                candidates.append(Candidate(c.label, (c.name,), *values, unit=c.unit, stated=c.stated))
    for name, reason in table.unread.items():
        unread.update(dict.fromkeys((ANY, *_meanings(name)), reason))
    doubt = "" if time is None else _doubt_time(table, time, stamps, candidates) or _doubt_pairs(columns, time)
    text = _describe_time(table, time, known_rate)
    return LogCandidates(tuple(candidates), keys, time, known_rate, text, doubt, unread)


def _meanings(name: str) -> Iterator[str]:
    """Yield the signals that a column of this name would be, by its words or its unit."""
    plain, unit = split_unit(name)
    yield from (signal for signal, kinds in QUANTITIES.items() if unit is not None and unit.quantity in kinds)
    if quantity := read_meaning((plain,)).quantity:
        yield quantity


def _read_columns(table: LogTable) -> tuple[list[_TableColumn], dict[str, str]]:
    """Return the columns that hold numbers, by name, or by number if the name is not unique; and why not the others."""
    columns: list[_TableColumn] = []
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
        columns.append(_TableColumn(key, values, stated or unit, plain, where))
    return columns, unread


def _without_path(error: RecordingError, table: LogTable) -> str:
    """Return an error's text without the file's name, which the import's own message begins with."""
    text = str(error).removeprefix(f"{table.path}:").strip()
    return f"line {text}" if text[:1].isdigit() else text


def _find_time(table: LogTable, columns: Sequence[_TableColumn], unread: dict[str, str]) -> LogColumn | None:
    """Return the column of the time: dates and exact stamps first, then a time by name or unit that goes forward."""
    if dates := _find_dates(table, columns, unread):
        return dates
    if "time" in unread:
        return None
    if counted := next(filter(None, map(_find_calendar, columns)), None):
        return counted
    for c in sorted((c for c in columns if c.goes_forward), key=lambda c: c.time_unit is None):
        if c.time_unit or c.named_time or split_words(c.name) in TIME_AXES:
            return c.as_time()
    for c in columns:  # whose fault is reported when it is read
        finite = c.values[np.isfinite(c.values)]
        named = c.time_unit or c.named_time or "time" in split_words(c.name)
        if named and len(finite) > 1 and np.ptp(finite) > 0.0:
            return c.as_time()
    return next((LogColumn(c.key) for c in columns[:1] if not table.names and c.goes_forward), None)


def _find_dates(table: LogTable, columns: Sequence[_TableColumn], unread: dict[str, str]) -> LogColumn | None:
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
                unread["time"] = _without_path(error, table)
    return None


def _find_calendar(column: _TableColumn) -> LogColumn | None:
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


def _holds_rate(column: _TableColumn) -> bool:
    """Return whether a column holds the rate, by its name and a constant number above 1."""
    finite = column.values[np.isfinite(column.values)]
    named = set(split_words(str(column.key))) & RATE_WORDS
    return bool(len(finite) and named and np.ptp(finite) == 0.0 and finite[0] > 1.0)


def _describe_time(table: LogTable, time: LogColumn | None, rate: float | LogColumn | None) -> str:
    if time is None:
        return f"rate from {rate.key!r}" if isinstance(rate, LogColumn) else f"rate {rate:g} Hz" if rate else ""
    if time.key == "":
        return "time from the first column"
    form = time.unit or ("s" if table.stamps(time) is None else "date or time of day")
    if time.offset:
        form = next(text for *_, offset, text in CALENDARS if offset == time.offset)
    return f"time from {time.key!r} [{form}]"


def _doubt_time(table: LogTable, time: LogColumn, stamps: Stamps, candidates: Sequence[Candidate]) -> str:
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
    stated = time.unit or time.scaled or table.stamps(time) is not None
    if stated or not usual or TableLimits.MIN_STEP_S <= usual < TableLimits.MAX_STEP_S:
        return ""
    other = "in hours or days" if usual < TableLimits.MIN_STEP_S else "in ms, or a number"
    return f"{where} states no unit; in seconds its steps are {usual:g} s (is it {other}?)"


def _doubt_pairs(columns: Sequence[_TableColumn], time: LogColumn) -> str:
    """Return that signals have times of their own, as in `t_x, x, t_F, F`, '' if one time is that of all."""
    chosen = next((c for c in columns if c.key == time.key), None)
    if chosen is None:
        return ""
    are_times = [(c.time_unit is not None or c.named_time) and c.goes_forward for c in columns]
    times = chosen.values * (chosen.time_unit.scale if chosen.time_unit else 1.0)
    for c, is_time, after_time in zip(columns, are_times, [True, *are_times], strict=False):
        if c is chosen or not is_time or after_time:
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
