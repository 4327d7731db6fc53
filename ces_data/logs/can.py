"""CAN logs (.blf, .asc, .trc, candump's .log, MDF) with DBC databases: signals MESSAGE.SIGNAL with their own times.

The log is read once, frame by frame; only frames whose messages are asked for are decoded. Logs as text are brought
into the form that python-can reads: its readers skip the negative times of a trigger, take relative times for absolute
ones, and know candump's files but not its console output.
"""

from __future__ import annotations

import re
from array import array
from collections import defaultdict
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from io import TextIOBase
from itertools import islice, pairwise
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ces_data.config_file import first_line
from ces_data.logs.log_file import LogSeries, Progress, TimedLog, import_reader, join_names
from ces_data.logs.log_mapping import DynoMapping, LogColumn
from ces_data.logs.mdf import read_frames
from ces_observer.errors import RecordingError

SAMPLE, RISING = 200, 0.9  # timed lines, of which more rise if the times are not relative
TIMED = re.compile(r"\s*(-?\d+\.\d+)(\s.*)", re.DOTALL)
RELATIVE = re.compile(r"\s*base\s+\w+\s+timestamps\s+relative", re.IGNORECASE)
CONSOLE = re.compile(
    r"\s*(?:\((?P<time>[^)]+)\)\s+)?(?P<bus>\S+)\s+(?:[TR]X\s+\S+\s+\S+\s+)?(?P<id>[0-9A-Fa-f]+)\s+\[(?P<length>\d+)\]"
    r"\s*(?P<data>(?:[0-9A-Fa-f]{2}\s?)*)"
)


class TextLines(TextIOBase):
    """The lines of a text log with times that python-can reads: `shift_s` is added to each of them."""

    def __init__(self, path: Path) -> None:
        self._asc, self.shift_s = path.suffix.lower() == ".asc", 0.0
        self._lines = self._asc_lines(path) if self._asc else _candump_lines(path)

    def __next__(self) -> str:  # type: ignore[override]
        return next(self._lines)

    def _asc_lines(self, path: Path) -> Iterator[str]:
        with path.open(encoding="utf-8", errors="replace") as file:
            relative, times = False, list[float]()
            for line in file:
                relative = relative or RELATIVE.match(line) is not None
                if match := TIMED.match(line):
                    times.append(float(match[1]))
                if len(times) == SAMPLE:
                    break
            rising = sum(after > before for before, after in pairwise(times))
            relative = relative and rising < RISING * (len(times) - 1)  # else the header is wrong
            self.shift_s = float(-min([0.0, *times]) // 1 + 1) if min(times, default=0.0) < 0.0 else 0.0
            file.seek(0)
            yield from _with_times(file, relative, self.shift_s)


def _with_times(lines: Iterator[str], relative: bool, shift_s: float) -> Iterator[str]:
    """Yield the lines of an ASC log; relative times count from the event before."""
    now_s, begun = 0.0, False
    for line in lines:
        match = TIMED.match(line)
        if match is None:
            yield line
            continue
        if not begun:  # the reader loses the line at which its search for this one ends
            yield "no internal events logged\n"
            begun = True
        now_s = float(match[1]) + now_s * relative
        yield f"{now_s + shift_s:.9f}{match[2]}"


def _candump_lines(path: Path) -> Iterator[str]:
    """Yield the lines of candump's log, made of its console output if the file holds that."""
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, start=1):
            match = CONSOLE.match(line)
            if match is None:
                yield line
                continue
            if match["time"] is None:
                what = f"{path}:{number}: candump's console output, which has no times"
                raise RecordingError(f"{what}; record the bus again with candump -l, or with candump -ta")
            data = "".join(match["data"].split())
            mark = "#" if int(match["length"]) <= 8 else "##0"
            yield f"({_seconds(match['time'], path, number):.9f}) {match['bus']} {match['id']}{mark}{data}\n"


def _seconds(text: str, path: Path, number: int) -> float:
    """Return the time that candump prints with -ta, -tz (a number) or -tA (a date)."""
    try:
        return float(text)
    except ValueError:
        try:
            return datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()
        except ValueError:
            expected = "expected seconds, or a date such as 2026-05-14 10:00:00.250"
            raise RecordingError(f"{path}:{number}: the time is {text!r}; {expected}") from None


MAX_PROPOSAL_FRAMES = 500_000
UNAVAILABLE = re.compile(r"not[ _]*avail|unavail|^s?na$|invalid|^error|not[ _]*valid|no[ _]*data|fault", re.IGNORECASE)
BUS_LOGS = (".blf", ".asc", ".log", ".trc")
Samples: TypeAlias = "dict[str, dict[str, tuple[array[int], array[float]]]]"  # by MESSAGE.SIGNAL and bus


def open_log(path: Path, mapping: DynoMapping, _: Progress) -> CanLog:
    """Open a CAN log; raises RecordingError without its database, or if a library is missing."""
    return CanLog(path, mapping)


class CanLog(TimedLog):
    """A CAN log. A multiplexed signal has a sample in each frame that carries it, and none in the others."""

    def __init__(self, path: Path, mapping: DynoMapping) -> None:
        self.path, self.source = path, mapping.source
        self._can = import_reader("can", path)
        self._cantools = import_reader("cantools", path)
        if not mapping.dbc:
            remedy = f"give dbc: FILE.dbc in {mapping.source}, or --dbc"
            raise RecordingError(f"{path}: a CAN log needs its database; {remedy}")
        self._database = self._cantools.database.Database(strict=False)
        for file in mapping.dbc:
            try:
                self._database.add_dbc_file(file)
            except OSError as error:
                raise RecordingError(f"{file}: cannot be read: {error.strerror or error}") from None
            except Exception as error:  # the parser and the checks of cantools raise errors of any kind
                raise RecordingError(f"{file}: not a DBC file: {str(error).splitlines()[0]}") from None
        self.notes = _find_lost_end(path)

    def read(self, columns: Sequence[LogColumn]) -> list[LogSeries]:
        """Return the signals in the order of the columns."""
        wanted = {str(column.key): self._find(str(column.key)) for column in columns}
        samples = self._decode([message for message, _ in wanted.values()])
        found = []
        for column in columns:
            name, (message, signal) = str(column.key), wanted[str(column.key)]
            buses = list(samples.get(name, ()))
            if not buses:
                what = f"id 0x{message.frame_id:X}, {'extended' if message.is_extended_frame else 'standard'}"
                raise RecordingError(f"{self.path}: no frame carries '{name}' ({what}); is it the right database?")
            bus = buses[0] if column.group is None else str(column.group)
            if bus not in buses or (column.group is None and len(buses) > 1):
                remedy = f"select one in {self.source}: {{column: {name}, group: {buses[0]}}}"
                raise RecordingError(f"{self.path}: '{name}' is on bus {' and '.join(buses)}; {remedy}")
            found.append(_to_series(name, name, samples, bus, signal.unit or ""))
        return found

    def read_all(self) -> list[LogSeries]:
        """Return every signal that occurs in the first 500,000 frames, apart for each bus that carries it."""
        samples = self._decode(self._database.messages, MAX_PROPOSAL_FRAMES)
        units = {f"{m.name}.{s.name}": s.unit or "" for m in self._database.messages for s in m.signals}
        return [
            _to_series(name if len(buses) == 1 else f"{name} (bus {bus})", name, samples, bus, units[name])
            for name, buses in samples.items()
            for bus in buses
        ]

    def _find(self, key: str) -> tuple[Any, Any]:
        """Return message and signal of the name MESSAGE.SIGNAL."""
        known = {m.name: m for m in reversed(self._database.messages)}
        message: Any = known.get(key.partition(".")[0])
        for signal in message.signals if message else ():
            if key == f"{message.name}.{signal.name}":
                return message, signal
        names = [f"{m.name}.{s.name}" for m in ([message] if message else self._database.messages) for s in m.signals]
        has = "the message has" if message else "expected MESSAGE.SIGNAL, one of"
        raise RecordingError(f"{self.path}: no signal '{key}'; {has} {join_names(names)}")

    def _decode(self, messages: Sequence[Any], limit: int | None = None) -> Samples:
        """Return the samples of all signals of these messages, in so many frames."""
        samples: Samples = defaultdict(lambda: defaultdict(lambda: (array("q"), array("d"))))
        unavailable = {(m.name, signal.name): _unavailable_values(signal) for m in messages for signal in m.signals}
        by_id: dict[tuple[int, bool], Any] = {(m.frame_id, m.is_extended_frame): m for m in messages}
        for frame in islice(self._frames(), limit):
            message = by_id.get((frame.arbitration_id, frame.is_extended_id))
            if message is None or frame.is_error_frame or frame.is_remote_frame:
                continue
            try:
                decoded = message.decode(bytes(frame.data), decode_choices=False, allow_truncated=True)
            except (self._cantools.Error, ValueError):
                continue  # a multiplexer value that the database does not have
            for name, value in decoded.items():
                if isinstance(value, int | float):
                    if value in unavailable[message.name, name]:
                        continue
                    stamps, values = samples[f"{message.name}.{name}"][str(frame.channel)]
                    stamps.append(round(frame.timestamp * 1e9))
                    values.append(float(value))
        _count_from_first(samples)
        return samples

    def _frames(self) -> Iterator[Any]:
        if self.path.suffix.lower() not in BUS_LOGS:
            yield from read_frames(self.path)
            return
        suffix, lines = self.path.suffix.lower(), TextLines(self.path)
        try:
            if suffix == ".asc":
                source = self._can.ASCReader(lines, relative_timestamp=False)
            else:
                source = self._can.CanutilsLogReader(lines) if suffix == ".log" else self._can.LogReader(self.path)
            with source as reader:
                for frame in reader:
                    frame.timestamp -= lines.shift_s
                    yield frame
        except (OSError, RecordingError):
            raise
        except Exception as error:  # the readers raise errors of any kind for a damaged file
            raise RecordingError(f"{self.path}: not a CAN log, or damaged: {first_line(error)}") from None


def _unavailable_values(signal: Any) -> frozenset[float]:
    """Return the values [in the signal's unit] that the database names as none, such as 65535 `not available`."""
    named = (raw for raw, name in (signal.choices or {}).items() if UNAVAILABLE.search(str(name)))
    return frozenset(signal.conversion.raw_to_scaled(raw, decode_choices=False) for raw in named)


def _count_from_first(samples: Samples) -> None:
    """Move all times so that none is negative: those before the trigger of a log without a date."""
    first = min((stamps[0] for buses in samples.values() for stamps, _ in buses.values() if stamps), default=0)
    for stamps, _ in (of for buses in samples.values() for of in buses.values()) if first < 0 else ():
        stamps[:] = array("q", (stamp - first for stamp in stamps))


def _find_lost_end(path: Path) -> tuple[str, ...]:
    """Return a note if a BLF file is shorter than its header states: its reader would end in silence."""
    if path.suffix.lower() != ".blf":
        return ()
    with path.open("rb") as file:
        head = file.read(24)
    stated = int.from_bytes(head[16:24], "little") if head.startswith(b"LOGG") and len(head) == 24 else 0
    size = path.stat().st_size
    return (f"the file ends early: it has {size} of {stated} bytes",) if size < stated else ()


def _to_series(label: str, name: str, samples: Samples, bus: str, unit: str) -> LogSeries:
    stamps, values = samples[name][bus]
    group = bus if len(samples[name]) > 1 else None
    return LogSeries(label, np.array(stamps, np.int64), np.array(values, np.float64), unit, name, group)
