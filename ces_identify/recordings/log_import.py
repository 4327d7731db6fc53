"""Dyno logs into recordings: a file and a mapping in; stamped position, current and force in SI units out."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ces_identify.recordings.log_mapping import Column, DynoMapping, FileNameValue, FixedValue, MappingError, Source
from ces_identify.recordings.log_table import LogTable, read_table
from ces_identify.recordings.recording import Channel, Recording, Stamps, Values
from ces_observer.errors import RecordingError
from ces_observer.signals import UNITS


def import_log(path: Path, mapping: DynoMapping) -> Recording:
    """Read a dyno log; a constant becomes a channel, too, so that the recording is complete.

    Stamps count from the log's time zero, or from its first row if that is earlier. Raises RecordingError for a missing
    column, a cell that is not a number, or a time that runs backwards.
    """
    table = read_table(path, mapping)
    columns = {name: _values(table, source, path, mapping) for name, source in mapping.signals.items()}
    lengths = {name: len(values) for name, values in columns.items() if not isinstance(values, float)}
    if len(set(lengths.values())) > 1:
        text = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise RecordingError(f"{path}: columns of different lengths ({text}); expected a value of each in every row")
    if not lengths:
        raise MappingError(f"{mapping.source}: no signal has a column; expected at least position and force")
    stamps = _stamps(table, mapping, path, next(iter(lengths.values())))
    channels = {
        name: Channel(name, UNITS[name], stamps, np.broadcast_to(values, stamps.shape))
        for name, values in columns.items()
    }
    return Recording(path.stem, channels, source=str(path))


def _values(table: LogTable, source: Source, path: Path, mapping: DynoMapping) -> Values | float:
    if isinstance(source, FixedValue):
        return source.value
    if isinstance(source, Column):
        return source.scale * table.column(source.key) + source.offset
    return source.scale * _number_in_name(source, path, mapping) + source.offset


def _number_in_name(source: FileNameValue, path: Path, mapping: DynoMapping) -> float:
    match = source.pattern.search(path.name)
    try:
        return float(match.group(1) if match else "")
    except (ValueError, TypeError):
        pattern = source.pattern.pattern
        raise MappingError(f"{mapping.source}: from_name '{pattern}' finds no number in '{path.name}'") from None


def _stamps(table: LogTable, mapping: DynoMapping, path: Path, count: int) -> Stamps:
    if mapping.time is None:
        rate = _rate(table, mapping.rate, path)
        return _to_nanoseconds(np.arange(count) / rate)
    seconds = mapping.time.scale * table.column(mapping.time.key) + mapping.time.offset
    if len(seconds) != count:
        raise RecordingError(f"{path}: {len(seconds)} times for {count} values; expected one for each")
    _require_forward(seconds, table, path)
    return _to_nanoseconds(seconds - min(0.0, seconds[0]))


def _to_nanoseconds(seconds: Values) -> Stamps:
    return np.asarray(np.rint(seconds * 1e9).astype(np.int64))


def _rate(table: LogTable, source: float | Column | None, path: Path) -> float:
    """Return the rate [Hz] of the mapping, or from the first row of its column."""
    if not isinstance(source, Column):
        return source or 1.0
    rate = source.scale * table.first(source.key) + source.offset
    if not np.isfinite(rate) or rate <= 0.0:
        raise RecordingError(f"{path}: the rate in column {source.key!r} is {rate:g} Hz; expected more than 0")
    return rate


def _require_forward(seconds: Values, table: LogTable, path: Path) -> None:
    if not np.isfinite(seconds).all():
        row = int(np.argmin(np.isfinite(seconds)))
        raise RecordingError(f"{path}: {table.place(row)}: the time is {seconds[row]}; expected seconds")
    backwards = np.flatnonzero(np.diff(seconds) < 0.0)
    if len(backwards):
        row = int(backwards[0])
        raise RecordingError(
            f"{path}: {table.place(row + 1)}: time runs backwards, from {seconds[row]:g} s to {seconds[row + 1]:g} s;"
            " expected rows in the order of time (or set a rate)"
        )
