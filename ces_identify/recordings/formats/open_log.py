"""Opens logs of every format: a path and a mapping in; a table, or channels with their own times, out."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import scipy.io

from ces_identify.recordings.formats.bag_log import BagLog
from ces_identify.recordings.formats.can_log import CanLog
from ces_identify.recordings.formats.csv_table import CsvTable
from ces_identify.recordings.formats.log_file import LogTable, TimedLog
from ces_identify.recordings.formats.mat73_file import is_mat73, open_mat73
from ces_identify.recordings.formats.mdf_log import MdfLog
from ces_identify.recordings.formats.parquet_table import ParquetTable
from ces_identify.recordings.formats.tree_table import TreeSeries, TreeTable, find_series, follow_route, list_series
from ces_identify.recordings.log_mapping import Column, DynoMapping
from ces_observer.errors import RecordingError

SUFFIXES = {
    "csv": (".csv", ".txt", ".dat", ".tsv"),
    "json": (".json",),
    "mat": (".mat",),
    "mdf": (".mf4", ".mdf", ".mf3"),
    "bag": (".bag",),
    "can": (".blf", ".asc", ".log"),
    "parquet": (".parquet", ".pq"),
}
MDF_MAGIC = (b"MDF     ", b"UnFinMF ")
BAGS = (".mcap", ".db3")


def open_log(path: Path, mapping: DynoMapping) -> LogTable | TimedLog:
    """Open a log; raises RecordingError if it does not have the format of the mapping or the suffix."""
    refuse_bag(path)
    if not path.exists():
        raise RecordingError(f"{path}: cannot be read: No such file or directory")
    kind = mapping.format or find_format(path)
    try:
        if kind in READERS:
            return READERS[kind](path, mapping)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from None
    except csv.Error as error:
        raise RecordingError(f'{path}: cannot be read as a table: {error}; is a quote (") not closed?') from None
    except (ValueError, TypeError, RecursionError, NotImplementedError) as error:
        raise RecordingError(f"{path}: not a {kind} file: {str(error).splitlines()[0]}") from None
    raise RecordingError(f"{path}: cannot tell the format from '{path.suffix}'; set format in {mapping.source}")


def refuse_bag(path: Path) -> None:
    """Raise RecordingError if the file or folder is a rosbag2 recording, which all programs read as it is."""
    if path.suffix in BAGS or (path.is_dir() and (path / "metadata.yaml").is_file()):
        raise RecordingError(f"{path}: a bag needs no import: ces info {path}")
    if path.is_dir():
        raise RecordingError(f"{path}: is a folder; expected a log (.csv, .mat, .mf4, ...)")


def find_format(path: Path) -> str:
    """Return the format that the suffix or the first bytes say, '' if neither does."""
    suffix = path.suffix.lower()
    if suffix == ".dat" and path.is_file():
        with path.open("rb") as file:
            if file.read(8) in MDF_MAGIC:
                return "mdf"  # MDF 3 files often have this suffix, as text tables do
    return next((kind for kind, suffixes in SUFFIXES.items() if suffix in suffixes), "")


def _open_json(path: Path, mapping: DynoMapping) -> LogTable | TimedLog:
    return _table_or_series(path, mapping, json.loads(path.read_bytes()))


def _open_mat(path: Path, mapping: DynoMapping) -> LogTable | TimedLog:
    if not is_mat73(path):
        return _table_or_series(path, mapping, scipy.io.loadmat(path, simplify_cells=True))
    return _table_or_series(path, mapping, open_mat73(path))


def _table_or_series(path: Path, mapping: DynoMapping, tree: Any) -> LogTable | TimedLog:
    """Return the series if the mapping gives no time and its columns are series, else the table."""
    root = follow_route(path, tree, mapping.rows)
    columns = [source for source in mapping.signals.values() if isinstance(source, Column)]
    if mapping.time is None and mapping.rate is None and isinstance(root, Mapping):
        if columns and all(find_series(follow_route(path, root, str(column.key))) for column in columns):
            return TreeSeries(path, root)
        if not columns and any(True for _ in list_series(root)):
            return TreeSeries(path, root)
    return TreeTable(path, mapping, tree)


READERS: dict[str, Callable[[Path, DynoMapping], LogTable | TimedLog]] = {
    "csv": CsvTable,
    "json": _open_json,
    "mat": _open_mat,
    "mdf": lambda path, _: MdfLog(path),
    "bag": lambda path, _: BagLog(path),
    "can": CanLog,
    "parquet": ParquetTable,
}
