"""A recording as a table on the position's times: a column for each channel, with the unit in its name.

A channel with other stamps is held or interpolated, and its column says so.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from ces_data.limits import RecordingLimits
from ces_data.logs.log_file import import_reader
from ces_data.recording import Channel, Recording, Stamps, Values
from ces_data.samples import measured_at
from ces_observer.errors import CesError
from ces_observer.signals import UNITS

HELD = ("current", "temperature")  # the newest value counts; the others are interpolated
SUFFIXES = {"m/s": "m_s", "m/s2": "m_s2"}  # of units that a column's name cannot hold
BATCH = 50_000  # rows that are converted at a time
SECOND = 1_000_000_000
FORMATS = ("csv", "parquet")


@dataclass(frozen=True)
class DataColumn:
    """A column, whose name ends with its unit: `values` float64 (n,), with no cell where `missing` (n,) is true."""

    name: str
    unit: str
    values: Values
    missing: NDArray[np.bool_]

    @classmethod
    def of(cls, name: str, unit: str, values: Values, missing: NDArray[np.bool_] | None = None) -> DataColumn:
        """Return the column of a signal, or of `signal_held` and the like."""
        mask = np.zeros(len(values), dtype=np.bool_) if missing is None else missing
        return cls(f"{name}_{SUFFIXES.get(unit, unit)}", unit, values, mask)

    @classmethod
    def at_rows(cls, name: str, channel: Channel, rows: NDArray[np.int64], count: int) -> DataColumn:
        """Return the column of a channel whose samples are in these rows of `count`."""
        values, missing = np.full(count, np.nan), np.ones(count, dtype=np.bool_)
        values[rows], missing[rows] = channel.values, False
        return cls.of(name, channel.unit, values, missing)


@dataclass(frozen=True)
class DataTable:
    """A table of n rows at `stamps_ns` (n,); `notes` are facts for the file's metadata."""

    stamps_ns: Stamps
    columns: tuple[DataColumn, ...]
    notes: Mapping[str, str]

    @property
    def time_ns(self) -> Stamps:
        """Times from the first row [ns]."""
        return np.asarray(self.stamps_ns - self.stamps_ns[0])

    @property
    def batches(self) -> Iterator[slice]:
        """The rows in batches."""
        return (slice(begin, begin + BATCH) for begin in range(0, len(self.stamps_ns), BATCH))


def tabulate(recording: Recording, more: Mapping[str, Channel]) -> DataTable:
    """Return a recording on the position's stamps.

    `more` are channels on some of these stamps, such as estimates; they have no cell where they have no sample.
    """
    stamps = recording.channel("position").stamps_ns
    columns = [_column(name, channel, stamps) for name, channel in recording.channels.items()]
    columns += [
        DataColumn.of(name, UNITS[name], np.full(len(stamps), value)) for name, value in recording.constants.items()
    ]
    for name, channel in more.items():
        rows = np.searchsorted(stamps, channel.stamps_ns)
        columns.append(DataColumn.at_rows(name, channel, rows, len(stamps)))
    notes = {"recording": recording.name, "source": recording.source, "source_sha256": recording.sha256}
    return DataTable(stamps, tuple(columns), notes)


def _column(name: str, channel: Channel, stamps: Stamps) -> DataColumn:
    """Return a channel on these stamps: as it is if they are its own, else held or interpolated."""
    if np.array_equal(channel.stamps_ns, stamps):
        return DataColumn.of(name, channel.unit, channel.values)
    if name in HELD:
        return DataColumn.of(f"{name}_held", channel.unit, *_hold(channel.finite(), stamps))
    values, missing = _interpolate(channel.finite(), stamps)
    if name == "force":
        missing |= ~measured_at(channel, stamps)
    return DataColumn.of(f"{name}_interp", channel.unit, values, missing)


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
    gap = own[after] - own[after - 1] > RecordingLimits.GAP_INTERVALS * np.median(np.diff(own))
    exact = (own[after] == stamps) | (own[after - 1] == stamps)
    start = int(own[0])
    values = np.interp((stamps - start).astype(np.float64), (own - start).astype(np.float64), channel.values)
    return np.asarray(values), np.asarray((stamps < own[0]) | (stamps > own[-1]) | (gap & ~exact))


def require_writer(path: Path, kind: str) -> None:
    """Raise CesError if the library that writes this kind of file is missing."""
    if kind == "parquet":
        import_reader("pyarrow", path, "writing")


def write_table(table: DataTable, path: Path, kind: str) -> None:
    """Write a table as `csv` or `parquet`; raises CesError if the file cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
            part = Path(folder) / path.name
            (_write_parquet if kind == "parquet" else _write_csv)(table, part)
            part.replace(path)
    except OSError as error:
        raise CesError(f"{path}: cannot be written: {error.strerror or error}; choose another place") from None


def _write_csv(table: DataTable, path: Path) -> None:
    """Write exact stamps, and numbers with as many digits as bring them back."""
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(["stamp_ns", "time_s", *(column.name for column in table.columns)]) + "\n")
        for rows in table.batches:
            times = [f"{t // SECOND}.{t % SECOND:09d}" for t in table.time_ns[rows].tolist()]
            pairs = [zip(c.values[rows].tolist(), c.missing[rows].tolist(), strict=True) for c in table.columns]
            cells = (["" if missing else repr(value) for value, missing in pair] for pair in pairs)
            lines = zip(table.stamps_ns[rows].tolist(), times, *cells, strict=True)
            file.writelines(f"{','.join(map(str, line))}\n" for line in lines)


def _write_parquet(table: DataTable, path: Path) -> None:
    """Write row groups with the unit of each column in its metadata, and the recording in the file's."""
    arrow, parquet = (import_reader(name, path, "writing") for name in ("pyarrow", "pyarrow.parquet"))
    fields = [
        arrow.field("stamp_ns", arrow.int64(), metadata={"unit": "ns"}),
        arrow.field("time_s", arrow.float64(), metadata={"unit": "s"}),
        *(arrow.field(c.name, arrow.float64(), metadata={"unit": c.unit}) for c in table.columns),
    ]
    schema = arrow.schema(fields, metadata=dict(table.notes))
    with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        for rows in table.batches:
            times = [arrow.array(table.stamps_ns[rows]), arrow.array(table.time_ns[rows] * 1e-9)]
            cells = [arrow.array(column.values[rows], mask=column.missing[rows]) for column in table.columns]
            writer.write_table(arrow.table([*times, *cells], schema=schema))
