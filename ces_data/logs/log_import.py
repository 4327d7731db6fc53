"""Logs into recordings: a file and a mapping in; stamped position, current and force in SI units out."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from ces_data.bags.reader import RecordingWarning, sort_late_samples
from ces_data.limits import TableLimits
from ces_data.logs.log_file import MAX_TIME_S, LogSeries, LogTable, TimedLog, open_log
from ces_data.logs.log_mapping import ONE_TIME, DynoMapping, FileNameValue, FixedValue, LogColumn, MappingError
from ces_data.recording import Channel, Recording, Stamps, Values
from ces_data.samples import INTEGRATED, with_stroke
from ces_data.units import QUANTITIES, find_unit, split_unit
from ces_observer.errors import RecordingError
from ces_observer.signals import MOTIONS, UNITS

Block = TypeVar("Block", LogTable, list[LogSeries])
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
    return join_blocks(list(read_blocks(log, mapping)))


def join_blocks(blocks: Sequence[Recording]) -> Recording:
    """Return the recording of a log's blocks; warns if its stroke is an integral."""
    recording = Recording.join(blocks)
    if "speed" in recording.channels.keys() - recording.optional:
        warnings.warn(f"{recording.name}: {INTEGRATED}", RecordingWarning, stacklevel=2)
    return recording


def read_blocks(log: LogTable | TimedLog, mapping: DynoMapping) -> Iterator[Recording]:
    """Yield the same in blocks, each of which goes on where the one before ends; a short log is one block.

    One with the speed alone is one block, too, in which the stroke is its integral.
    """
    if "position" not in mapping.signals:
        yield with_stroke(Recording.join(list(_read_blocks(log, mapping))))
    else:
        optional = frozenset(MOTIONS) & mapping.signals.keys()
        yield from (replace(block, optional=optional) for block in _read_blocks(log, mapping))


def _read_blocks(log: LogTable | TimedLog, mapping: DynoMapping) -> Iterator[Recording]:
    if not any(isinstance(source, LogColumn) for source in mapping.signals.values()):
        raise MappingError(f"{mapping.source}: {NO_COLUMN}")
    columns = {name: source for name, source in mapping.signals.items() if isinstance(source, LogColumn)}
    if isinstance(log, TimedLog):
        for key, given in (("time", mapping.time), ("rate", mapping.rate)):
            if given is not None:
                remedy = f"remove '{key}': the channels of {log.path.name} have their own times"
                raise MappingError(f"{mapping.source}: {remedy}")
        for series in _guard(log.blocks(list(columns.values())), log.path):
            yield _of_series(log, mapping, dict(zip(columns, series, strict=True)))
        return
    if mapping.time is None and mapping.rate is None:
        raise MappingError(f"{mapping.source}: {ONE_TIME}")
    clock, rate = TableClock(), 1.0 if mapping.time else _rate(log, mapping.rate)
    used = [*columns.values(), *([mapping.time] if mapping.time else [])]
    for table in _guard(log.blocks(used), log.path):
        yield _of_table(table, mapping, rate, clock)


def _guard(blocks: Iterator[Block], path: Path) -> Iterator[Block]:
    try:
        yield from blocks
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from None


@dataclass
class TableClock:
    """The time of a table's blocks so far: rows, the first stamp and its place, the last, and what is added to all."""

    rows: int = 0
    first_ns: int = 0
    first_place: str = ""
    last_ns: int = 0
    shift_ns: int = 0
    gap_ns: int = 0  # that is put between blocks
    digits: bool = False  # whether its numbers are hours, minutes and seconds, one after the other


def _of_table(table: LogTable, mapping: DynoMapping, rate: float, clock: TableClock) -> Recording:
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
        stamps = np.rint(np.arange(clock.rows, clock.rows + count) / rate * 1e9).astype(np.int64)
        stamps = part_blocks(stamps, table.breaks, clock)
        clock.rows, clock.last_ns = clock.rows + count, int(stamps[-1]) if count else 0
    else:
        stamps = read_times(table, mapping.time, count, clock)
    channels = {}
    delays_ns = {name: s.delay_ns if isinstance(s, LogColumn) else 0 for name, s in mapping.signals.items()}
    largest_ns = max(delays_ns.values())
    stamps = stamps + (largest_ns if clock.first_ns < largest_ns else 0)  # those of a bag are not negative
    for name, column in columns.items():
        source = mapping.signals[name]
        channel = Channel(name, UNITS[name], stamps - delays_ns[name], np.broadcast_to(column, stamps.shape))
        missing = table.missing(source.key) if isinstance(source, LogColumn) else None
        channels[name] = channel if missing is None else channel.select(~missing)
    return Recording(table.called or table.path.stem, channels, source=str(table.path))


def _of_series(log: TimedLog, mapping: DynoMapping, series_by_name: Mapping[str, LogSeries]) -> Recording:
    """Return the channels with their own stamps; a constant has those of the position, or of the first channel."""
    stamps = series_by_name.get("position", next(iter(series_by_name.values()))).stamps_ns
    channels = {}
    for name, source in mapping.signals.items():
        if isinstance(source, LogColumn):
            series = series_by_name[name]
            where = f"{log.path}: '{series.label}'"
            scale, offset = find_factors(name, source, series.unit, where, mapping.source)
            moved = series.stamps_ns - source.delay_ns
            channel, _ = sort_late_samples(Channel(name, UNITS[name], moved, scale * series.values + offset))
            _require_forward(channel.stamps_ns, log.path, partial("'{}', sample {}".format, series.label))
            channels[name] = channel
        else:
            values = np.full(stamps.shape, _constant(source, log.path, mapping))
            channels[name] = Channel(name, UNITS[name], stamps, values)
    return Recording(log.path.stem, channels, source=str(log.path))


def find_factors(signal: str, column: LogColumn, unit: str, where: str, source: str) -> tuple[float, float]:
    """Return scale and offset: the mapping's, or the stated unit's; raises MappingError if it is not the signal's."""
    named = split_unit(str(column.key))[1]  # of a force only: `x_A` may be that of damper A
    if signal == "current" and not unit.strip() and named is not None and named.quantity == "force":
        unit = named.text
    if column.scaled or not unit.strip():
        return column.scale, column.offset
    stated = find_unit(unit)
    if stated is None or stated.quantity not in QUANTITIES[signal] or stated.quantity == "voltage":
        raise MappingError(
            f"{where} is in '{unit}', which is not a unit of a {signal} [{UNITS[signal]}]; give {signal} a unit or "
            f"scale in {source}"
        )
    return stated.scale, stated.offset


def _constant(source: FixedValue | FileNameValue, path: Path, mapping: DynoMapping) -> float:
    if isinstance(source, FixedValue):
        return source.value
    match = source.pattern.search(path.name)
    try:
        return source.scale * float(match.group(1) if match else "") + source.offset
    except (ValueError, TypeError):
        pattern = source.pattern.pattern
        raise MappingError(f"{mapping.source}: from_name '{pattern}' finds no number in '{path.name}'") from None


def read_times(table: LogTable, column: LogColumn, count: int, clock: TableClock | None = None) -> Stamps:
    """Return the stamps of a table's time column [ns]; raises RecordingError unless there are `count`, in order.

    `clock` is that of the blocks before, and goes on to the end of this one.
    """
    clock = clock or TableClock()
    stamps = table.stamps(column)
    if stamps is None:
        stated = None if column.scaled else find_unit(table.unit(column.key))  # the unit that the file states
        scale = stated.scale if stated is not None and stated.quantity == "time" else column.scale
        numbers = table.column(column.key)
        clock.digits = clock.digits or (not column.scaled and is_digital_clock(numbers))
        seconds = read_digits(numbers) if clock.digits else scale * numbers + column.offset
        _require_finite(seconds, table)
        stamps = np.rint(seconds / scale if scale == 1e-9 else seconds * 1e9).astype(np.int64)
        if not clock.rows and len(stamps):
            clock.shift_ns = -min(0, int(stamps[0]))
        stamps = stamps + clock.shift_ns
    if len(stamps) != count:
        raise RecordingError(f"{table.path}: {len(stamps)} times for {count} values; expected one for each")
    stamps = part_blocks(stamps, table.breaks, clock, timed=True)
    if not clock.rows and count:
        clock.first_ns, clock.first_place = int(stamps[0]), table.place(0)
    places: Callable[[int], str] = lambda row: table.place(row - 1) if row else clock.first_place  # noqa: E731
    joined, place = (np.append(clock.last_ns, stamps), places) if clock.rows else (stamps, table.place)
    advice = "--rate {} (in a mapping, rate: in place of time)"
    _require_forward(joined, table.path, place, advice, clock.first_ns)
    clock.rows, clock.last_ns = clock.rows + count, int(joined[-1]) if len(joined) else 0
    return stamps


def part_blocks(stamps: Stamps, breaks: Mapping[int, bool], clock: TableClock, timed: bool = False) -> Stamps:
    """Return the stamps with a gap before each of these rows: a block may begin again at zero, or where one ended.

    Where the names alone came again, a time of the table may go on.
    """
    moved = stamps + clock.gap_ns
    for row, repeated in breaks.items():
        before = int(moved[row - 1]) if row else clock.last_ns
        if timed and repeated and moved[row] > before:
            continue
        gap_ns = max(0, before + round(TableLimits.BLOCK_GAP_S * 1e9) - int(moved[row]))
        moved[row:] += gap_ns
        clock.gap_ns += gap_ns
    return np.asarray(moved)


def is_digital_clock(numbers: Values) -> bool:
    """Return whether numbers are times of day as HHMMSS.sss, which jump by 40 at each full minute.

    Within a minute they count seconds, whatever they are.
    """
    if len(numbers) < TableLimits.MIN_SAMPLES or not np.isfinite(numbers).all() or numbers.min() < 0.0:
        return False
    steps, minutes = np.diff(numbers), np.diff(np.floor(numbers / 100.0))
    valid = (numbers < 240_000.0) & (numbers % 100.0 < 60.0) & (numbers // 100.0 % 100.0 < 60.0)
    jumps = steps[minutes > 0.0]
    return bool(valid.all() and len(jumps) and (jumps > 40.0).all() and np.median(steps) < TableLimits.MAX_STEP_S)


def read_digits(numbers: Values) -> Values:
    """Return the seconds since midnight of times as HHMMSS.sss."""
    return np.asarray(numbers // 10_000 * 3600.0 + numbers // 100 % 100 * 60.0 + numbers % 100.0)


def _rate(table: LogTable, source: float | LogColumn | None) -> float:
    """Return the rate [Hz] of the mapping, or from the first row of its column."""
    if not isinstance(source, LogColumn):
        return source or 1.0
    rate = source.scale * table.first(source.key) + source.offset
    if not np.isfinite(rate) or rate < TableLimits.MIN_RATE_HZ:
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


def _require_forward(
    stamps: Stamps, path: Path, place: Callable[[int], str], rate: str = "", first_ns: int | None = None
) -> None:
    """Raise RecordingError for a time that runs backwards, with what to do about a log of this kind.

    `place` names a row (from 0) for the message; `rate` says how the rate is given in place of the time, if it can be;
    `first_ns` is where the log begins, if not at the first of these stamps.
    """
    steps = np.diff(stamps)
    backwards, forward = np.flatnonzero(steps < 0), steps[steps > 0]
    if not len(backwards):
        return
    if not len(forward):
        raise RecordingError(f"{path}: the newest row is first; reverse the rows")
    row, more = int(backwards[0]), f" ({len(backwards) - 1} more below)" if len(backwards) > 1 else ""
    begin, again = (stamps[i] * 1e-9 for i in (row, row + 1))
    what = f"{path}: {place(row + 1)}: time runs backwards, from {begin:.13g} s to {again:.13g} s{more}"
    usual = float(np.median(forward))
    cut = f"cut it before {place(row + 1)}"
    given = f"give {rate.format(f'{1e9 / usual:.6g}')}, or {cut}" if rate else cut
    ordered = np.sort(stamps)
    between = ordered[1:] - ordered[:-1]
    if _is_even(between, float(np.median(between))):
        remedy = "rows are out of order, and no time is missing; sort the rows by time"
    elif cause := _name_step_back(1e-9 * float(stamps[row] + usual - stamps[row + 1]), 1e-9 * usual):
        remedy = f"{cause}; {given}"
    elif stamps[row + 1] <= (stamps[0] if first_ns is None else first_ns) + 2.0 * usual:
        remedy = f"it begins again: these are several recordings, or one in a loop; {cut}"
    elif rate and _is_even(forward, usual):
        remedy = (
            f"was the clock set back? If the sampling went on evenly, {given.replace(', or', '; if it stopped there,')}"
        )
    else:
        remedy = f"was the clock set back? Then {cut}"
    raise RecordingError(f"{what}: {remedy}")


def _name_step_back(back_s: float, usual_s: float) -> str:
    """Return why a time may step back by just so much, '' if it is no such step."""
    if abs(back_s - 3600.0) < usual_s:
        return "it is an hour, as where summer time ends"
    counters = ((bits, unit_s) for bits in (16, 32) for unit_s in (1e-3, 1e-6))
    wraps = (bits for bits, unit_s in counters if abs(back_s - 2**bits * unit_s) < usual_s)
    return next((f"a counter of {bits} bits began again at zero, and the time goes on" for bits in wraps), "")


def _is_even(steps: Stamps, usual: float) -> bool:
    return bool(np.all(np.abs(steps - usual) < 0.5 * usual))
