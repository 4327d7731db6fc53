"""CAN frames in an MDF file (ASAM's bus logging): structures `CAN_DataFrame` with the frame's id, bus and bytes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ces_identify.recordings.formats.mdf_log import BUS_FRAMES, opened_mdf, start_ns
from ces_observer.errors import RecordingError


@dataclass(frozen=True)
class MdfFrame:
    """A frame as python-can's `Message` has it; `timestamp` counts seconds from 1970."""

    timestamp: float
    arbitration_id: int
    is_extended_id: bool
    channel: int
    data: bytes
    is_error_frame: bool = False
    is_remote_frame: bool = False


def read_frames(path: Path) -> Iterator[MdfFrame]:
    """Yield the frames of an MDF file, group by group; raises RecordingError if it has none."""
    with opened_mdf(path) as mdf:
        groups = sorted({group for group, _ in mdf.channels_db.get(f"{BUS_FRAMES}.DataBytes", ())})
        if not groups:
            raise RecordingError(f"{path}: holds no CAN frames; its channels have names of their own: leave dbc out")
        for group in groups:
            yield from _read_group(mdf, group, start_ns(mdf) * 1e-9)


def _read_group(mdf: Any, group: int, start_s: float) -> Iterator[MdfFrame]:
    data = mdf.get(f"{BUS_FRAMES}.DataBytes", group=group)
    lengths, ids = _numbers(mdf, group, "DataLength"), _numbers(mdf, group, "ID")
    buses, extended = _numbers(mdf, group, "BusChannel"), _numbers(mdf, group, "IDE")
    for at, time in enumerate(data.timestamps.tolist()):
        length = int(lengths[at]) if lengths is not None else data.samples.shape[1]
        yield MdfFrame(
            start_s + time,
            int(ids[at]) & 0x1FFFFFFF,
            bool(extended[at]) if extended is not None else bool(int(ids[at]) >> 31),
            int(buses[at]) if buses is not None else group,
            data.samples[at, :length].tobytes(),
        )


def _numbers(mdf: Any, group: int, name: str) -> Any:
    """Return the numbers of a field of the frames, None if the file does not have it."""
    places = [place for place in mdf.channels_db.get(f"{BUS_FRAMES}.{name}", ()) if place[0] == group]
    return mdf.get(group=group, index=places[0][1], raw=True).samples if places else None
