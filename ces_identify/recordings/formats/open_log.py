"""Opens logs of every format: a path and a mapping in; a table, or channels with their own times, out."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import scipy.io

from ces_identify.recordings.formats.csv_table import CsvTable
from ces_identify.recordings.formats.log_file import LogTable, TimedLog
from ces_identify.recordings.formats.tree_table import TreeSeries, TreeTable, find_series, follow_route, list_series
from ces_identify.recordings.log_mapping import Column, DynoMapping
from ces_observer.errors import RecordingError

SUFFIXES = {
    ".csv": "csv",
    ".txt": "csv",
    ".dat": "csv",
    ".tsv": "csv",
    ".json": "json",
    ".mat": "mat",
}
BAGS = (".mcap", ".db3")


def open_log(path: Path, mapping: DynoMapping) -> LogTable | TimedLog:
    """Open a log; raises RecordingError if it does not have the format of the mapping or the suffix."""
    refuse_bag(path)
    kind = mapping.format or find_format(path)
    try:
        if kind == "csv":
            return CsvTable(path, mapping)
        if kind == "json":
            return _table_or_series(path, mapping, json.loads(path.read_bytes()))
        if kind == "mat":
            return _table_or_series(path, mapping, scipy.io.loadmat(path, simplify_cells=True))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from None
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
    return SUFFIXES.get(path.suffix.lower(), "")


def _table_or_series(path: Path, mapping: DynoMapping, tree: Any) -> LogTable | TimedLog:
    """Return the series if the mapping gives no time and its columns are series, else the table."""
    root = follow_route(path, tree, mapping.rows)
    columns = [source for source in mapping.signals.values() if isinstance(source, Column)]
    if mapping.time is None and mapping.rate is None and isinstance(root, dict):
        if columns and all(find_series(follow_route(path, root, str(column.key))) for column in columns):
            return TreeSeries(path, root)
        if not columns and any(True for _ in list_series(root)):
            return TreeSeries(path, root)
    return TreeTable(path, mapping, tree)
