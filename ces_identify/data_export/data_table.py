"""A recording as a table: a column for each channel, with the unit in its name.

On common times (the position's, or a uniform grid) a channel with other stamps is held or interpolated, and its column
says so. As logged, there is a row for each stamp of any channel, and a cell is empty where its channel has no sample.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ces_identify.recordings.channel_stats import GAP_INTERVALS
from ces_identify.recordings.holes import measured_at
from ces_identify.recordings.recording import Channel, Recording, Stamps, Values
from ces_observer.errors import RecordingError
from ces_observer.signals import UNITS

HELD = ("current", "temperature")  # the newest value counts; the others are interpolated
SUFFIXES = {"m/s": "m_s", "m/s2": "m_s2"}  # of units that a column's name cannot hold
MAX_RATE_RATIO = 2.0  # of a uniform grid to the fastest channel; more rows would hold nothing new


@dataclass(frozen=True)
class DataColumn:
    """A column: `values` float64 (n,), with no cell where `missing` (n,) is true."""

    name: str
    unit: str
    values: Values
    missing: NDArray[np.bool_]


@dataclass(frozen=True)
class DataTable:
    """A table of n rows at `stamps_ns` (n,); `notes` are facts for the file's metadata."""

    name: str
    stamps_ns: Stamps
    columns: tuple[DataColumn, ...]
    notes: Mapping[str, str] = field(default_factory=dict)

    @property
    def time_ns(self) -> Stamps:
        """Times from the first row [ns]."""
        return np.asarray(self.stamps_ns - self.stamps_ns[0])


def tabulate(recording: Recording, more: Mapping[str, Channel], *, rate_Hz: float | None = None) -> DataTable:
    """Return a recording on the position's stamps, or on a uniform grid of `rate_Hz`.

    `more` are channels on some of the position's stamps, such as estimates; on those stamps they have no cell where
    they have no sample. Raises RecordingError for a rate beyond twice that of the fastest channel.
    """
    position = recording.channel("position")
    stamps: Stamps = position.stamps_ns if rate_Hz is None else _uniform(recording, rate_Hz)
    columns = [_column(name, channel, stamps) for name, channel in recording.channels.items()]
    columns += [
        DataColumn(f"{name}_{_suffix(UNITS[name])}", UNITS[name], np.full(len(stamps), value), _none(stamps))
        for name, value in recording.constants.items()
    ]
    columns += [_place(name, c, stamps) if rate_Hz is None else _column(name, c, stamps) for name, c in more.items()]
    return DataTable(recording.name, stamps, tuple(columns), _notes(recording))


def tabulate_as_logged(recording: Recording, more: Mapping[str, Channel]) -> DataTable:
    """Return all samples of all channels; equal stamps of one channel have a row each."""
    channels = {**recording.channels, **more}
    keys = {name: _keys(channel.stamps_ns) for name, channel in channels.items()}
    rows = np.unique(np.concatenate(list(keys.values())))
    columns = []
    for name, channel in channels.items():
        at = np.searchsorted(rows, keys[name])
        values, missing = np.full(len(rows), np.nan), np.ones(len(rows), dtype=np.bool_)
        values[at], missing[at] = channel.values, False
        columns.append(DataColumn(f"{name}_{_suffix(channel.unit)}", channel.unit, values, missing))
    return DataTable(recording.name, rows["stamp"].copy(), tuple(columns), _notes(recording))


def _keys(stamps: Stamps) -> NDArray[np.void]:
    """Return stamp and number among equal stamps of each sample."""
    first = np.searchsorted(stamps, stamps, side="left")
    keys = np.empty(len(stamps), dtype=[("stamp", np.int64), ("repeat", np.int64)])
    keys["stamp"], keys["repeat"] = stamps, np.arange(len(stamps)) - first
    return keys


def _uniform(recording: Recording, rate_Hz: float) -> Stamps:
    position = recording.channel("position").stamps_ns
    fastest = max(_rate(channel) for channel in recording.channels.values())
    if rate_Hz > MAX_RATE_RATIO * fastest:
        raise RecordingError(
            f"{recording.name}: --rate {rate_Hz:g} is more than twice the {fastest:.4g} Hz of its fastest channel; "
            "nothing was recorded between"
        )
    count = int((position[-1] - position[0]) * rate_Hz / 1e9) + 1
    return np.asarray(position[0] + np.rint(np.arange(count) * (1e9 / rate_Hz)).astype(np.int64))


def _rate(channel: Channel) -> float:
    span = int(np.ptp(channel.stamps_ns)) if len(channel) else 0
    return (len(channel) - 1) * 1e9 / span if span else 0.0


def _column(name: str, channel: Channel, stamps: Stamps) -> DataColumn:
    """Return a channel on these stamps: as it is if they are its own, else held or interpolated."""
    unit = _suffix(channel.unit)
    if np.array_equal(channel.stamps_ns, stamps):
        return DataColumn(f"{name}_{unit}", channel.unit, channel.values, _none(stamps))
    finite = channel.select(np.isfinite(channel.values))
    if name in HELD:
        values, missing = _hold(finite, stamps)
        return DataColumn(f"{name}_held_{unit}", channel.unit, values, missing)
    values, missing = _interpolate(finite, stamps)
    if name == "force":
        missing |= ~measured_at(channel, stamps)
    return DataColumn(f"{name}_interp_{unit}", channel.unit, values, missing)


def _place(name: str, channel: Channel, stamps: Stamps) -> DataColumn:
    at = np.searchsorted(stamps, channel.stamps_ns)
    values, missing = np.full(len(stamps), np.nan), np.ones(len(stamps), dtype=np.bool_)
    values[at], missing[at] = channel.values, False
    return DataColumn(f"{name}_{_suffix(channel.unit)}", channel.unit, values, missing)


def _hold(channel: Channel, stamps: Stamps) -> tuple[Values, NDArray[np.bool_]]:
    """Return the newest value at or before each stamp; none before the first."""
    newest = np.searchsorted(channel.stamps_ns, stamps, side="right") - 1
    values = channel.values[np.maximum(newest, 0)] if len(channel) else np.full(len(stamps), np.nan)
    return np.asarray(values), np.asarray((newest < 0) | (len(channel) == 0))


def _interpolate(channel: Channel, stamps: Stamps) -> tuple[Values, NDArray[np.bool_]]:
    """Return the line between the neighbours of each stamp; none outside the channel and in its gaps."""
    if len(channel) < 2:
        return np.full(len(stamps), np.nan), np.ones(len(stamps), dtype=np.bool_)
    own = channel.stamps_ns
    after = np.clip(np.searchsorted(own, stamps, side="left"), 1, len(own) - 1)
    gap = own[after] - own[after - 1] > GAP_INTERVALS * np.median(np.diff(own))
    exact = (own[after] == stamps) | (own[after - 1] == stamps)
    start = int(own[0])
    values = np.interp((stamps - start).astype(np.float64), (own - start).astype(np.float64), channel.values)
    return np.asarray(values), np.asarray((stamps < own[0]) | (stamps > own[-1]) | (gap & ~exact))


def _none(stamps: Stamps) -> NDArray[np.bool_]:
    return np.zeros(len(stamps), dtype=np.bool_)


def _suffix(unit: str) -> str:
    return SUFFIXES.get(unit, unit)


def _notes(recording: Recording) -> dict[str, str]:
    return {"recording": recording.name, "source": recording.source, "source_sha256": recording.sha256}


def iterate_rows(table: DataTable, batch: int) -> Iterator[slice]:
    """Yield the rows of a table in batches."""
    for begin in range(0, len(table.stamps_ns), batch):
        yield slice(begin, begin + batch)
