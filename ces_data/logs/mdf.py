"""MDF 3 and 4 measurement files (.mf4, .mdf): channels in groups with their own times, units and conversions."""

from __future__ import annotations

import gc
import logging
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ces_data.config_file import first_line
from ces_data.logs.log_file import (
    MAX_ROWS,
    LogSeries,
    LogTable,
    Progress,
    TimedLog,
    align_blocks,
    import_reader,
    join_names,
    open_format,
)
from ces_data.logs.log_mapping import DynoMapping, LogColumn
from ces_observer.errors import RecordingError

BUS_FRAMES = "CAN_DataFrame"
MAX_PROPOSAL_RECORDS = 200_000
Place = tuple[int, int]  # numbers of a channel group and of a channel in it


def open_log(path: Path, mapping: DynoMapping, progress: Progress) -> LogTable | TimedLog:
    """Open an MDF file, one of CAN frames with the database that the mapping names."""
    return open_format("can", path, mapping, progress) if mapping.dbc else MdfLog(path, progress)


class MdfLog(TimedLog):
    """An MDF file. Samples that its invalidation bits mark are left out; times count from its start time, in UTC.

    A channel is named by its name alone if it is unique, else with the number or name of its group.
    """

    def __init__(self, path: Path, progress: Progress) -> None:
        self.path, self._progress = path, progress
        import_reader("asammdf", path)

    def read(self, columns: Sequence[LogColumn]) -> list[LogSeries]:
        """Return the channels of these names; one after the other is read from the file."""
        with opened_mdf(self.path) as mdf:
            return [self._series(mdf, self._find(mdf, column), start_ns(mdf)) for column in columns]

    def blocks(self, columns: Sequence[LogColumn]) -> Iterator[list[LogSeries]]:
        """Yield the channels in blocks of time; of each, so many records are read at a time."""
        with opened_mdf(self.path) as mdf:
            start, places = start_ns(mdf), [self._find(mdf, column) for column in columns]
            records = [mdf.groups[group].channel_group.cycles_nr for group, _ in places]
            parts = [self._parts(mdf, place, start, count) for place, count in zip(places, records, strict=True)]
            done, total = 0, max(1, sum(records))
            for block in align_blocks(parts):
                yield block
                done += sum(len(series.stamps_ns) for series in block)
                self._progress(min(1.0, done / total))

    def _parts(self, mdf: Any, place: Place, start: int, records: int) -> Iterator[LogSeries]:
        for offset in range(0, max(1, records), MAX_ROWS):
            yield self._series(mdf, place, start, MAX_ROWS if records > MAX_ROWS else None, offset)

    def read_all(self) -> list[LogSeries]:
        """Return the first 200,000 samples of every channel of numbers."""
        with opened_mdf(self.path) as mdf:
            start = start_ns(mdf)
            if f"{BUS_FRAMES}.DataBytes" in mdf.channels_db:
                remedy = "give their database: --dbc FILE.dbc, or dbc in a mapping"
                raise RecordingError(f"{self.path}: holds CAN frames, not signals; {remedy}")
            found, masters = [], set(mdf.masters_db.items())
            seen: set[Place] = set()  # a channel may have a second name, as `force\XCP:1` is also `force`
            for name, places in mdf.channels_db.items():
                for place in sorted(set(places) - masters - seen):
                    seen.add(place)
                    with suppress(RecordingError):  # text and structures are not signals
                        series = self._series(mdf, place, start, MAX_PROPOSAL_RECORDS)
                        group = place[0] if len(set(places) - masters) > 1 else None
                        label = name if group is None else f"{name} (group {group})"
                        found.append(replace(series, label=label, key=name, group=group))
            return found

    def _find(self, mdf: Any, column: LogColumn) -> Place:
        masters = set(mdf.masters_db.items())
        places: list[Place] = sorted(set(mdf.channels_db.get(str(column.key), ())) - masters)
        if not places:
            names = [name for name, where in mdf.channels_db.items() if not set(where) <= masters]
            raise RecordingError(f"{self.path}: no channel {column.key!r}; the file has {join_names(names)}")
        records = {place: mdf.groups[place[0]].channel_group for place in places}
        groups = {p: str(getattr(g, "acq_name", None) or getattr(g, "comment", None) or "") for p, g in records.items()}
        if column.group is not None:
            places = [place for place in places if column.group in (place[0], groups[place])]
        if len(places) != 1:
            texts = [f"{place[0]} '{groups[place]}'" if groups[place] else str(place[0]) for place in places]
            has = f"is in {len(places)} groups ({', '.join(texts) or f'not {column.group!r}'})"
            remedy = f"give one as {{column: {column.key}, group: NUMBER}}"
            raise RecordingError(f"{self.path}: channel {column.key!r} {has}; {remedy}")
        return places[0]

    def _series(self, mdf: Any, place: Place, start: int, count: int | None = None, offset: int = 0) -> LogSeries:
        signal = mdf.get(group=place[0], index=place[1], record_offset=offset, record_count=count)
        if signal.samples.dtype.kind not in "biuf" or signal.samples.ndim != 1:
            raise RecordingError(f"{self.path}: channel '{signal.name}' holds no numbers but {signal.samples.dtype}")
        stamps = start + np.rint(signal.timestamps * 1e9).astype(np.int64)
        return LogSeries(signal.name, stamps, signal.samples.astype(np.float64), signal.unit or "", signal.name)


@contextmanager
def opened_mdf(path: Path) -> Iterator[Any]:
    """Open an MDF file with asammdf; raises RecordingError if it is damaged or the library is missing."""
    library = import_reader("asammdf", path)
    logging.getLogger("asammdf").setLevel(logging.CRITICAL)  # its errors are raised as well, and reported here
    try:
        with path.open("rb") as file, library.MDF(file) as mdf:
            yield mdf
    except (OSError, RecordingError):
        raise
    except Exception as error:  # asammdf raises errors of any kind for a damaged file
        reason = first_line(error)
        hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
        error.__traceback__ = error.__context__ = error.__cause__ = None
        gc.collect()  # frees the half-made file, whose own clean-up would print a traceback
        sys.unraisablehook = hook
        raise RecordingError(f"{path}: not an MDF file, or damaged: {reason}") from None


def start_ns(mdf: Any) -> int:
    """Return the file's start time [ns since 1970, UTC], 0 if it has none."""
    start = mdf.header.start_time
    return max(0, round(start.timestamp() * 1e6) * 1_000) if start is not None else 0


def read_frames(path: Path) -> Iterator[Any]:
    """Yield the frames of an MDF file as python-can's `Message`, group by group; raises RecordingError if it has none.

    Their `timestamp` counts seconds from 1970. python-can's own reader passes in silence over groups without a source.
    """
    library = import_reader("can", path)
    with opened_mdf(path) as mdf:
        groups = sorted({group for group, _ in mdf.channels_db.get(f"{BUS_FRAMES}.DataBytes", ())})
        if not groups:
            raise RecordingError(f"{path}: holds no CAN frames; its channels have names of their own: leave dbc out")
        start_s = start_ns(mdf) * 1e-9
        for group in groups:
            data = mdf.get(f"{BUS_FRAMES}.DataBytes", group=group)
            names = ("DataLength", "ID", "BusChannel", "IDE")
            lengths, ids, buses, extended = (_numbers(mdf, group, name) for name in names)
            for at, time in enumerate(data.timestamps.tolist()):
                length = int(lengths[at]) if lengths is not None else data.samples.shape[1]
                yield library.Message(
                    timestamp=start_s + time,
                    arbitration_id=int(ids[at]) & 0x1FFFFFFF,
                    is_extended_id=bool(extended[at]) if extended is not None else bool(int(ids[at]) >> 31),
                    channel=int(buses[at]) if buses is not None else group,
                    data=data.samples[at, :length].tobytes(),
                )


def _numbers(mdf: Any, group: int, name: str) -> Any:
    """Return the numbers of a field of the frames, None if the file does not have it."""
    places = [place for place in mdf.channels_db.get(f"{BUS_FRAMES}.{name}", ()) if place[0] == group]
    return mdf.get(group=group, index=places[0][1], raw=True).samples if places else None
