"""The candidates in bags, and in a log: its columns, or its channels with their own times, and the time of the rows."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ces_data.bags.fields import FieldSeries, read_fields
from ces_data.limits import TableLimits
from ces_data.logs.csv_form import find_other_unit
from ces_data.logs.log_file import LogTable, TimedLog
from ces_data.logs.log_import import TableClock, part_blocks, read_times
from ces_data.logs.log_mapping import LogColumn
from ces_data.mapping.rating import Candidate, read_meaning
from ces_data.mapping.times import (
    TableColumn,
    describe_time,
    doubt_pairs,
    doubt_rate,
    doubt_time,
    find_time,
    holds_rate,
    read_period,
    without_path,
)
from ces_data.units import QUANTITIES, find_unit, split_unit
from ces_observer.errors import RecordingError

MAX_COLUMNS = 256  # of a table without names
DIALLED_PATH = re.compile(r"(Platform\(\)://)?Model Root/")  # before each name in ControlDesk's exports
BETWEEN_BAGS_NS = 10_000_000_000
SERIES_NAMES = frozenset(
    ("topic", "field", "series", "metric", "channel", "signal", "variable", "sensor", "tag", "name")
)
ANY = ""  # key of what may be any signal


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
        names=(*filter(None, [sample.element]), field_name, topic_name, sample.type.rpartition("/")[2]),
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
            reason = f"{series.label!r} holds too few numbers ({np.isfinite(series.values).sum()})"
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
    if reason := _describe_long(table, columns):
        raise RecordingError(f"{table.path}: {reason}")
    time = None if rate else find_time(table, columns, unread)
    counted = None if time or rate else next(filter(holds_rate, columns), None)
    if not (time or rate or counted):
        rate = next(filter(None, map(read_period, columns)), table.stated_Hz) or None
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
                few = f"{there.sum()} in {len(there)} rows; expected at least {TableLimits.MIN_SAMPLES}"
                reason = f"{c.key!r} holds too few numbers ({few})"
                unread.update(dict.fromkeys(_meanings(str(c.key)), reason))
            else:
                values = (stamps, c.values) if there.all() else (stamps[there], c.values[there])
                timed = time is not None or known_rate is not None
                kept = Candidate(c.label, (c.name,), *values, unit=c.unit, stated=c.stated, timed=timed)
                candidates.append(replace(kept, contrary=c.contrary))
    if not unread and not any(np.isfinite(c.values).any() for c in columns):
        unread[ANY] = "no column holds numbers"
    for name, reason in table.unread.items():
        unread.update(dict.fromkeys((ANY, *_meanings(name)), reason))
    doubt = ""
    if time is not None:
        doubt = doubt_time(table, time, stamps, candidates) or doubt_pairs(columns, time)
        doubt = doubt or doubt_rate(table, time, stamps, columns)
    text = describe_time(table, time, known_rate)
    return LogCandidates(tuple(candidates), keys, time, known_rate, text, doubt, unread)


def _describe_long(table: LogTable, columns: Sequence[TableColumn]) -> str:
    """Return that each row holds one value and says of what, as databases and Foxglove export them, '' if not."""
    numbers = {column.key for column in columns}
    series = next((n for n in table.names if n.strip("_").casefold() in SERIES_NAMES and n not in numbers), "")
    value = next((n for n in table.names if n.strip("_").casefold() == "value"), "")
    if not series or not value:
        return ""
    return (
        f"each row holds one value, of what column '{series}' says; make a column of each, as pandas does with "
        f"pivot(index=..., columns='{series}', values='{value}'), the index being the column of the time"
    )


def _meanings(name: str) -> Iterator[str]:
    """Yield the signals that a column of this name would be, by its words or its unit."""
    plain, unit = split_unit(name)
    yield from (signal for signal, kinds in QUANTITIES.items() if unit is not None and unit.quantity in kinds)
    if quantity := read_meaning((plain,)).quantity:
        yield quantity


def _read_columns(table: LogTable) -> tuple[list[TableColumn], dict[str, str]]:
    """Return the columns that hold numbers, by name, or by number if the name is not unique; and why not the others."""
    columns: list[TableColumn] = []
    unread: dict[str, str] = {}
    for i, name in enumerate(table.names or range(min(table.width, MAX_COLUMNS))):
        key = i if list(table.names).count(str(name)) > 1 or not table.names or not str(name) else str(name)
        try:
            values = table.column(key)
        except RecordingError as error:
            unread.update({signal: without_path(error, table) for signal in _meanings(str(name))})
            continue
        stated = find_unit(table.unit(key))
        plain, unit = split_unit(table.title(key) or DIALLED_PATH.sub("", str(name)))
        where = "from the header" if stated else "from its name" if unit else ""
        if other := "" if stated or unit else find_other_unit(table.unit(key) or str(name)):
            where = other
        differs = stated and unit and stated.quantity == unit.quantity and stated != unit
        columns.append(TableColumn(key, values, stated or unit, plain, where, unit.text if unit and differs else ""))
    return columns, unread
