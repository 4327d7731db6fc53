"""Writes tables as CSV or Parquet, batch by batch, to a temporary file beside the final one, which is then renamed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ces_identify.data_export.data_table import DataColumn, DataTable, iterate_rows
from ces_identify.recordings.formats.log_file import import_reader
from ces_observer.errors import CesError

BATCH = 50_000  # rows that are converted at a time
SECOND = 1_000_000_000
FORMATS = ("csv", "parquet")


def require_writer(path: Path, kind: str) -> None:
    """Raise CesError if the library that writes this kind of file is missing."""
    if kind == "parquet":
        try:
            import_reader("pyarrow", "pyarrow", "parquet", path)
        except CesError as error:
            raise CesError(str(error).replace("reading", "writing")) from None


def write_table(table: DataTable, path: Path, kind: str) -> None:
    """Write a table as `csv` or `parquet`; raises CesError if the file cannot be written."""
    write = _write_parquet if kind == "parquet" else _write_csv
    with _beside(path) as part:
        write(table, part)


def _write_csv(table: DataTable, path: Path) -> None:
    """Write exact stamps, and numbers with as many digits as bring them back."""
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(["stamp_ns", "time_s", *(column.name for column in table.columns)]) + "\n")
        for rows in iterate_rows(table, BATCH):
            times = [f"{t // SECOND}.{t % SECOND:09d}" for t in table.time_ns[rows].tolist()]
            cells = [_texts(column, rows) for column in table.columns]
            lines = zip(table.stamps_ns[rows].tolist(), times, *cells, strict=True)
            file.writelines(f"{','.join(map(str, line))}\n" for line in lines)


def _texts(column: DataColumn, rows: slice) -> list[str]:
    pairs = zip(column.values[rows].tolist(), column.missing[rows].tolist(), strict=True)
    return ["" if missing else repr(value) for value, missing in pairs]


def _write_parquet(table: DataTable, path: Path) -> None:
    """Write row groups with the unit of each column in its metadata, and the recording in the file's."""
    arrow, parquet = (import_reader(name, "pyarrow", "parquet", path) for name in ("pyarrow", "pyarrow.parquet"))
    fields = [
        arrow.field("stamp_ns", arrow.int64(), metadata={"unit": "ns"}),
        arrow.field("time_s", arrow.float64(), metadata={"unit": "s"}),
        *(arrow.field(c.name, arrow.float64(), metadata={"unit": c.unit}) for c in table.columns),
    ]
    schema = arrow.schema(fields, metadata=dict(table.notes))
    with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        for rows in iterate_rows(table, BATCH):
            writer.write_table(arrow.table(_arrays(table, rows, arrow), schema=schema))


def _arrays(table: DataTable, rows: slice, arrow: Any) -> list[Any]:
    cells = [arrow.array(column.values[rows], mask=column.missing[rows]) for column in table.columns]
    return [arrow.array(table.stamps_ns[rows]), arrow.array(table.time_ns[rows] * 1e-9), *cells]


@contextmanager
def _beside(path: Path) -> Iterator[Path]:
    """Give a path in a temporary folder beside `path`, and rename what was written there to `path`."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
            part = Path(folder) / path.name
            yield part
            part.replace(path)
    except OSError as error:
        raise CesError(f"{path}: cannot be written: {error.strerror or error}; choose another place") from None
