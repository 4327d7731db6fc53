"""CAN logs (.blf, .asc, .trc, candump's .log, MDF) with DBC databases: signals MESSAGE.SIGNAL with their own times.

The log is read once, frame by frame; only frames whose messages are asked for are decoded.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ces_data.logs.log_file import LogSeries, TimedLog, import_reader, join_names
from ces_data.logs.log_mapping import Column, DynoMapping
from ces_data.logs.mdf import read_frames
from ces_observer.errors import RecordingError

EXTRA = "can"
MAX_PROPOSAL_FRAMES = 500_000
BUS_LOGS = (".blf", ".asc", ".log", ".trc")
FrameId = tuple[int, bool]  # arbitration id, and whether it is an extended one


def open_log(path: Path, mapping: DynoMapping, _: Callable[[float], None]) -> CanLog:
    """Open a CAN log; raises RecordingError without its database, or if a library is missing."""
    return CanLog(path, mapping)


@dataclass
class _Samples:
    """The growing samples of one signal, by bus."""

    stamps: dict[str, array[int]] = field(default_factory=dict)
    values: dict[str, array[float]] = field(default_factory=dict)

    def add(self, bus: str, stamp_ns: int, value: float) -> None:
        self.stamps.setdefault(bus, array("q")).append(stamp_ns)
        self.values.setdefault(bus, array("d")).append(value)


class CanLog(TimedLog):
    """A CAN log. A multiplexed signal has a sample in each frame that carries it, and none in the others."""

    def __init__(self, path: Path, mapping: DynoMapping) -> None:
        self.path, self.source = path, mapping.source
        self._can = import_reader("can", "python-can", EXTRA, path)
        self._cantools = import_reader("cantools", "cantools", EXTRA, path)
        if not mapping.dbc:
            raise RecordingError(
                f"{path}: a CAN log needs its database; give dbc: FILE.dbc in {mapping.source}, or --dbc"
            )
        self._database = self._load(mapping.dbc)
        self.notes = _find_lost_end(path)

    def read(self, columns: Sequence[Column]) -> list[LogSeries]:
        """Return the signals in the order of the columns."""
        wanted = {str(column.key): self._find(str(column.key)) for column in columns}
        messages = {_frame_id(message): message for message, _ in wanted.values()}
        samples = self._decode(messages, None)
        return [self._series(column, *wanted[str(column.key)], samples) for column in columns]

    def read_all(self) -> list[LogSeries]:
        """Return every signal that occurs in the first 500,000 frames, apart for each bus that carries it."""
        samples = self._decode({_frame_id(m): m for m in self._database.messages}, MAX_PROPOSAL_FRAMES)
        units = {f"{m.name}.{s.name}": s.unit or "" for m in self._database.messages for s in m.signals}
        return [
            _to_series(name if len(found.stamps) == 1 else f"{name} (bus {bus})", name, found, bus, units[name])
            for name, found in samples.items()
            for bus in found.stamps
        ]

    def _load(self, files: Sequence[Path]) -> Any:
        database = self._cantools.database.Database(strict=False)
        for path in files:
            try:
                database.add_dbc_file(path)
            except OSError as error:
                raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from None
            except Exception as error:  # the parser and the checks of cantools raise errors of any kind
                raise RecordingError(f"{path}: not a DBC file: {str(error).splitlines()[0]}") from None
        return database

    def _find(self, key: str) -> tuple[Any, Any]:
        """Return message and signal of the name MESSAGE.SIGNAL."""
        message_name, _, signal_name = key.partition(".")
        message = next((m for m in self._database.messages if m.name == message_name), None)
        if message is None:
            names = [f"{m.name}.{s.name}" for m in self._database.messages for s in m.signals]
            raise RecordingError(f"{self.path}: no signal '{key}'; expected MESSAGE.SIGNAL, one of {join_names(names)}")
        signal = next((s for s in message.signals if s.name == signal_name), None)
        if signal is None:
            names = [f"{message.name}.{s.name}" for s in message.signals]
            raise RecordingError(f"{self.path}: no signal '{key}'; the message has {join_names(names)}")
        return message, signal

    def _decode(self, messages: dict[FrameId, Any], limit: int | None) -> dict[str, _Samples]:
        """Return the samples of all signals of these messages, by MESSAGE.SIGNAL."""
        samples: dict[str, _Samples] = {}
        for count, frame in enumerate(self._frames()):
            if count == limit:
                break
            message = messages.get((frame.arbitration_id, frame.is_extended_id))
            if message is None or frame.is_error_frame or frame.is_remote_frame:
                continue
            stamp_ns, bus = round(frame.timestamp * 1e9), str(frame.channel)
            for name, value in self._values(message, frame.data).items():
                samples.setdefault(f"{message.name}.{name}", _Samples()).add(bus, stamp_ns, value)
        return samples

    def _frames(self) -> Iterator[Any]:
        if self.path.suffix.lower() not in BUS_LOGS:
            yield from read_frames(self.path)
            return
        options = {"relative_timestamp": False} if self.path.suffix.lower() == ".asc" else {}
        try:
            with self._can.LogReader(self.path, **options) as reader:
                yield from reader
        except OSError:
            raise
        except Exception as error:  # the readers raise errors of any kind for a damaged file
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            raise RecordingError(f"{self.path}: not a CAN log, or damaged: {reason}") from None

    def _values(self, message: Any, data: bytes) -> dict[str, float]:
        try:
            decoded = message.decode(bytes(data), decode_choices=False, allow_truncated=True)
        except (self._cantools.Error, ValueError):
            return {}  # a frame with a multiplexer value that the database does not have
        return {name: float(value) for name, value in decoded.items() if isinstance(value, int | float)}

    def _series(self, column: Column, message: Any, signal: Any, samples: dict[str, _Samples]) -> LogSeries:
        name = f"{message.name}.{signal.name}"
        found = samples.get(name)
        if found is None:
            kind = "extended" if message.is_extended_frame else "standard"
            raise RecordingError(
                f"{self.path}: no frame carries '{name}' (id 0x{message.frame_id:X}, {kind}); is it the right database?"
            )
        bus = self._bus(column, name, found.stamps)
        return _to_series(name, name, found, bus, signal.unit or "")

    def _bus(self, column: Column, name: str, buses: Iterable[str]) -> str:
        known = list(buses)
        if column.group is not None and str(column.group) in known:
            return str(column.group)
        if column.group is None and len(known) == 1:
            return known[0]
        raise RecordingError(
            f"{self.path}: '{name}' is on bus {' and '.join(known)}; select one in {self.source}: "
            f"{{column: {name}, group: {known[0]}}}"
        )


def _find_lost_end(path: Path) -> tuple[str, ...]:
    """Return a note if a BLF file is shorter than its header states: its reader would end in silence."""
    if path.suffix.lower() != ".blf":
        return ()
    with path.open("rb") as file:
        head = file.read(24)
    stated = int.from_bytes(head[16:24], "little") if head.startswith(b"LOGG") and len(head) == 24 else 0
    size = path.stat().st_size
    return (f"the file ends early: it has {size} of {stated} bytes",) if size < stated else ()


def _frame_id(message: Any) -> FrameId:
    return message.frame_id, message.is_extended_frame


def _to_series(label: str, key: str, found: _Samples, bus: str, unit: str) -> LogSeries:
    group: str | None = bus if len(found.stamps) > 1 else None
    stamps = np.array(found.stamps[bus], dtype=np.int64)
    return LogSeries(label, stamps, np.array(found.values[bus], dtype=np.float64), unit, key, group)
