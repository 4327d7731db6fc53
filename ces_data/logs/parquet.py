"""Parquet tables: only the columns that are used are read; their units come from the fields' metadata."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ces_data.logs.log_file import MAX_ROWS, LogTable, Progress, import_reader
from ces_data.logs.log_mapping import DynoMapping, LogColumn
from ces_data.recording import Stamps, Values
from ces_observer.errors import RecordingError


def open_log(path: Path, mapping: DynoMapping, progress: Progress) -> ParquetTable:
    """Open a Parquet file; raises RecordingError if it is damaged or pyarrow is missing."""
    return ParquetTable(path, mapping, progress)


class ParquetTable(LogTable):
    """A block of a Parquet file, first that of its first rows; a null is a blank cell."""

    _block, _begin = None, 0  # the columns of a block that is read, and its first row

    def __init__(self, path: Path, mapping: DynoMapping, progress: Progress) -> None:
        self.path, self.mapping, self._progress = path, mapping, progress
        parquet = import_reader("pyarrow.parquet", path)
        self._arrow = import_reader("pyarrow", path)
        self._arrow.set_memory_pool(self._arrow.system_memory_pool())  # its own pool keeps what is freed
        try:
            self._file = parquet.ParquetFile(path, buffer_size=1 << 20, pre_buffer=False)
        except self._arrow.ArrowInvalid as error:
            raise RecordingError(f"{path}: not a Parquet file, or damaged: {str(error).splitlines()[0]}") from None
        self._schema = self._file.schema_arrow
        self.names = mapping.names or tuple(self._schema.names)
        if not self._file.metadata.num_rows:
            raise RecordingError(f"{path}: the table is empty; expected rows of numbers")

    def blocks(self, columns: Sequence[LogColumn]) -> Iterator[ParquetTable]:
        """Yield the table in blocks of rows with these columns."""
        count, begin = self._file.metadata.num_rows, 0
        for block in self._batches([self._name(column.key) for column in columns]) if count > MAX_ROWS else ():
            table = copy(self)
            table._block, table._begin, begin = block, begin, begin + block.num_rows
            yield table
            self._progress(begin / count)
        if count <= MAX_ROWS:
            yield self

    def column(self, key: str | int) -> Values:
        """Return a column, NaN where it is null; raises RecordingError if it holds no numbers."""
        column, name = self._read(key)
        kind = column.type
        types = self._arrow.types
        if not (types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind) or types.is_decimal(kind)):
            raise RecordingError(f"{self.path}: column {name!r} is {kind}; expected numbers")
        if column.null_count and self.mapping.blank == "error":
            row = self._begin + int(np.argmax(column.is_null().to_numpy()))
            remedy = f"if a null is a missing sample, set blank: missing in {self.mapping.source}"
            raise RecordingError(f"{self.path}: row {row}: column {name!r} is null; expected a number ({remedy})")
        return np.asarray(column.cast(self._arrow.float64(), safe=False).to_numpy(), dtype=np.float64)

    def missing(self, key: str | int) -> NDArray[np.bool_] | None:
        """Return which rows are null in a column, None if none is."""
        column, _ = self._read(key)
        return np.asarray(column.is_null().to_numpy(), dtype=np.bool_) if column.null_count else None

    def stamps(self, column: LogColumn) -> Stamps | None:
        """Return the times of a column of timestamps or of whole nanoseconds; None for other numbers."""
        values, _ = self._read(column.key)
        if values.null_count:
            return None
        if self._arrow.types.is_timestamp(values.type):
            return np.asarray(values.to_numpy().astype("datetime64[ns]").astype(np.int64))
        if self._arrow.types.is_duration(values.type):
            return np.asarray(values.to_numpy().astype("timedelta64[ns]").astype(np.int64))
        exact = column.unit == "ns" and self._arrow.types.is_integer(values.type)
        return np.asarray(values.to_numpy(), dtype=np.int64) if exact else None

    def unit(self, key: str | int) -> str:
        """Return the unit in the field's metadata."""
        metadata = self._schema.field(self._index(key, len(self.names))).metadata or {}
        return bytes(metadata.get(b"unit", b"")).decode("utf-8", "replace")

    def place(self, row: int) -> str:
        """Return the number of a row of the block in the file."""
        return f"row {self._begin + row}"

    def _name(self, key: str | int) -> str:
        return str(self._schema.names[self._index(key, len(self.names))])

    def _batches(self, names: Sequence[str]) -> Iterator[Any]:
        for batch in self._file.iter_batches(MAX_ROWS, columns=list(dict.fromkeys(names)), use_threads=False):
            yield self._arrow.Table.from_batches([batch])

    def _read(self, key: str | int) -> tuple[Any, str]:
        """Return a column of the block, and its name in the file."""
        name = self._name(key)
        block = next(self._batches([name])) if self._block is None else self._block
        return block.column(name), name
