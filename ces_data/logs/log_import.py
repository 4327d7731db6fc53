"""Logs into recordings: a file and a mapping in; stamped position, current and force in SI units out."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ces_data.logs.log_file import MAX_TIME_S, LogTable, TimedLog, open_log
from ces_data.logs.log_mapping import ONE_TIME, DynoMapping, FileNameValue, FixedValue, LogColumn, MappingError
from ces_data.recording import Channel, Recording, Stamps, Values
from ces_data.units import QUANTITIES, find_unit
from ces_observer.errors import RecordingError
from ces_observer.signals import UNITS

MIN_RATE_HZ = 1.0e-6
NO_COLUMN = "no signal has a column; expected at least position and force"


def import_log(path: Path, mapping: DynoMapping) -> Recording:
    """Read a log; a constant becomes a channel, too, so that the recording is complete.

    Stamps of tables count from the log's time zero, or from its first row if that is earlier; dates, and the times of
    logs that state when they began, are kept. Raises RecordingError for a missing column, a cell that is not a number,
    or a time that runs backwards.
    """
    return to_recording(open_log(path, mapping), mapping)


def to_recording(log: LogTable | TimedLog, mapping: DynoMapping) -> Recording:
    """Return the signals that the mapping finds in an open log, as `import_log` does."""
    if not any(isinstance(source, LogColumn) for source in mapping.signals.values()):
        raise MappingError(f"{mapping.source}: {NO_COLUMN}")
    if isinstance(log, TimedLog):
        return _read_series(log, mapping)
    if mapping.time is None and mapping.rate is None:
        raise MappingError(f"{mapping.source}: {ONE_TIME}")
    return _read_table(log, mapping)


def _read_table(table: LogTable, mapping: DynoMapping) -> Recording:
    columns: dict[str, Values | float] = {}
    for name, source in mapping.signals.items():
        if not isinstance(source, LogColumn):
            columns[name] = _constant(source, table.path, mapping)
            continue
        values, where = table.column(source.key), f"{table.path}: column {source.key!r}"
        scale, offset = find_factors(name, source, table.unit(source.key), where, mapping.source)
        columns[name] = scale * values + offset
    lengths = {name: len(values) for name, values in columns.items() if not isinstance(values, float)}
    if len(set(lengths.values())) > 1:
        text = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise RecordingError(
            f"{table.path}: columns of different lengths ({text}); expected a value of each in every row"
        )
    count = next(iter(lengths.values()))
    if mapping.time is None:
        stamps = np.rint(np.arange(count) / _rate(table, mapping.rate) * 1e9).astype(np.int64)
    else:
        stamps = read_times(table, mapping.time, count)
    channels = {}
    for name, column in columns.items():
        channel = Channel(name, UNITS[name], stamps, np.broadcast_to(column, stamps.shape))
        source = mapping.signals[name]
        missing = table.missing(source.key) if isinstance(source, LogColumn) else None
        channels[name] = channel if missing is None else channel.select(~missing)
    return Recording(table.path.stem, channels, source=str(table.path))


def _read_series(log: TimedLog, mapping: DynoMapping) -> Recording:
    """Return the channels with their own stamps; a constant has those of the position, or of the first channel."""
    for key, given in (("time", mapping.time), ("rate", mapping.rate)):
        if given is not None:
            raise MappingError(
                f"{mapping.source}: remove '{key}': the channels of {log.path.name} have their own times"
            )
    columns = {name: source for name, source in mapping.signals.items() if isinstance(source, LogColumn)}
    found = dict(zip(columns, log.read(list(columns.values())), strict=True))
    stamps = found.get("position", next(iter(found.values()))).stamps_ns
    channels = {}
    for name, source in mapping.signals.items():
        if isinstance(source, LogColumn):
            series = found[name]
            where = f"{log.path}: '{series.label}'"
            scale, offset = find_factors(name, source, series.unit, where, mapping.source)
            channels[name] = Channel(name, UNITS[name], series.stamps_ns, scale * series.values + offset)
        else:
            values = np.full(stamps.shape, _constant(source, log.path, mapping))
            channels[name] = Channel(name, UNITS[name], stamps, values)
    return Recording(log.path.stem, channels, source=str(log.path))


def find_factors(signal: str, column: LogColumn, unit: str, where: str, source: str) -> tuple[float, float]:
    """Return scale and offset: the mapping's, or the stated unit's; raises MappingError if it is not the signal's."""
    if column.scaled or not unit.strip():
        return column.scale, column.offset
    known = find_unit(unit)
    if known is None or known.quantity not in QUANTITIES[signal]:
        raise MappingError(
            f"{where} is in '{unit}', which is not a unit of a {signal} [{UNITS[signal]}]; give {signal} a unit or "
            f"scale in {source}"
        )
    return known.scale, known.offset


def _constant(source: FixedValue | FileNameValue, path: Path, mapping: DynoMapping) -> float:
    if isinstance(source, FixedValue):
        return source.value
    match = source.pattern.search(path.name)
    try:
        return source.scale * float(match.group(1) if match else "") + source.offset
    except (ValueError, TypeError):
        pattern = source.pattern.pattern
        raise MappingError(f"{mapping.source}: from_name '{pattern}' finds no number in '{path.name}'") from None


def read_times(table: LogTable, column: LogColumn, count: int) -> Stamps:
    """Return the stamps of a table's time column [ns]; raises RecordingError unless there are `count`, in order."""
    stamps = table.stamps(column)
    if stamps is None:
        known = None if column.scaled else find_unit(table.unit(column.key))  # the unit that the file states
        scale = known.scale if known is not None and known.quantity == "time" else column.scale
        seconds = scale * table.column(column.key) + column.offset
        _require_finite(seconds, table)
        stamps = np.rint(seconds / scale if scale == 1e-9 else seconds * 1e9).astype(np.int64)
        stamps = stamps - min(0, int(stamps[0])) if len(stamps) else stamps
    if len(stamps) != count:
        raise RecordingError(f"{table.path}: {len(stamps)} times for {count} values; expected one for each")
    _require_forward(stamps, table)
    return stamps


def _rate(table: LogTable, source: float | LogColumn | None) -> float:
    """Return the rate [Hz] of the mapping, or from the first row of its column."""
    if not isinstance(source, LogColumn):
        return source or 1.0
    rate = source.scale * table.first(source.key) + source.offset
    if not np.isfinite(rate) or rate < MIN_RATE_HZ:
        raise RecordingError(f"{table.path}: the rate in column {source.key!r} is {rate:g} Hz; expected more than 0")
    return rate


def _require_finite(seconds: Values, table: LogTable) -> None:
    if not np.isfinite(seconds).all():
        row = int(np.argmin(np.isfinite(seconds)))
        raise RecordingError(f"{table.path}: {table.place(row)}: the time is {seconds[row]}; expected seconds")
    if len(seconds) and np.abs(seconds).max() > MAX_TIME_S:
        row = int(np.argmax(np.abs(seconds)))
        raise RecordingError(
            f"{table.path}: {table.place(row)}: the time is {seconds[row]:g} s; expected below {MAX_TIME_S:g} s (is "
            "it in ms, us or ns? Give the time its unit)"
        )


def _require_forward(stamps: Stamps, table: LogTable) -> None:
    backwards = np.flatnonzero(np.diff(stamps) < 0)
    if len(backwards) > 1 and len(backwards) == np.count_nonzero(np.diff(stamps)):
        raise RecordingError(f"{table.path}: the rows are in descending order of time; sort them by time")
    if len(backwards):
        row = int(backwards[0])
        raise RecordingError(
            f"{table.path}: {table.place(row + 1)}: time runs backwards, from {stamps[row] * 1e-9:.10g} s to "
            f"{stamps[row + 1] * 1e-9:.10g} s; expected rows in the order of time (or set a rate)"
        )
