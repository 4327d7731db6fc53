"""Opens logs of every format: a path and a mapping in; a table, or channels with their own times, out."""

from __future__ import annotations

import csv
import json
import re
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import scipy.io
from scipy.io.matlab import MatlabOpaque, MatReadWarning, varmats_from_mat

from ces_identify.recordings.formats.bag_log import BagLog
from ces_identify.recordings.formats.can_log import CanLog
from ces_identify.recordings.formats.csv_table import CsvTable
from ces_identify.recordings.formats.log_file import LogTable, TimedLog
from ces_identify.recordings.formats.mat73_file import is_mat73, open_mat73
from ces_identify.recordings.formats.matlab_objects import replace_objects
from ces_identify.recordings.formats.mdf_log import MdfLog
from ces_identify.recordings.formats.parquet_table import ParquetTable
from ces_identify.recordings.formats.tree_table import TreeSeries, TreeTable, find_series, follow_route, list_series
from ces_identify.recordings.log_mapping import Column, DynoMapping
from ces_observer.errors import RecordingError

SUFFIXES = {
    "csv": (".csv", ".txt", ".dat", ".tsv", ".lvm"),
    "json": (".json",),
    "mat": (".mat",),
    "mdf": (".mf4", ".mdf", ".mf3"),
    "bag": (".bag",),
    "can": (".blf", ".asc", ".log", ".trc"),
    "parquet": (".parquet", ".pq"),
}
MDF_MAGIC = (b"MDF     ", b"UnFinMF ")
REMEDIES = {  # what to do about files that are not read
    **dict.fromkeys((".xlsx", ".xls", ".xlsm", ".ods"), "save the sheet as CSV"),
    **dict.fromkeys((".gz", ".zip", ".7z", ".bz2", ".xz", ".tar", ".rar"), "unpack it"),
    **dict.fromkeys((".tdms", ".tdm"), "export it as CSV (DIAdem, or NI's TDMS add-in for Excel)"),
    **dict.fromkeys((".dxd", ".d7d", ".dsd"), "export it as CSV, MAT or MDF from DewesoftX"),
    **dict.fromkeys((".h5", ".hdf5", ".hdf"), "only MATLAB's own HDF5 files (.mat) are; write CSV or Parquet"),
    **dict.fromkeys((".jsonl", ".ndjson"), "write one JSON list of the rows (jq -s . FILE), or CSV"),
}
CAN_ASC = re.compile(rb"^\s*(date\s|base\s+(hex|dec)|//\s*version|Begin\s+Trigger)", re.IGNORECASE | re.MULTILINE)
BAGS = (".mcap", ".db3")


def open_log(
    path: Path, mapping: DynoMapping, progress: Callable[[float], None] = lambda share: None
) -> LogTable | TimedLog:
    """Open a log; raises RecordingError if it does not have the format of the mapping or the suffix.

    `progress` is called with the share of a text table that is read.
    """
    refuse_bag(path)
    if not path.exists():
        raise RecordingError(f"{path}: cannot be read: No such file or directory")
    kind = mapping.format or find_format(path)
    try:
        if kind == "csv":
            return CsvTable(path, mapping, progress)
        if kind in READERS:
            return READERS[kind](path, mapping)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from None
    except csv.Error as error:
        raise RecordingError(f'{path}: cannot be read as a table: {error}; is a quote (") not closed?') from None
    except (ValueError, TypeError, RecursionError, NotImplementedError) as error:
        raise RecordingError(f"{path}: not a {kind} file: {str(error).splitlines()[0]}") from None
    if hint := REMEDIES.get(path.suffix.lower()):
        raise RecordingError(f"{path}: is not read: {hint}")
    raise RecordingError(
        f"{path}: cannot tell the format from '{path.suffix}'; if it is one of {', '.join(SUFFIXES)}, set format in "
        f"{mapping.source}"
    )


def refuse_bag(path: Path) -> None:
    """Raise RecordingError if the file or folder is a rosbag2 recording, which all programs read as it is."""
    if path.suffix in BAGS or (path.is_dir() and (path / "metadata.yaml").is_file()):
        raise RecordingError(f"{path}: a bag needs no import: ces info {path}")
    if path.is_dir():
        raise RecordingError(f"{path}: is a folder; expected a log (.csv, .mat, .mf4, ...)")


def find_format(path: Path) -> str:
    """Return the format that the suffix or the first bytes say, '' if neither does."""
    suffix = path.suffix.lower()
    head = b""
    if suffix in (*SUFFIXES["csv"], ".asc") and path.is_file():
        with path.open("rb") as file:
            head = file.read(4096)
    if head[:8] in MDF_MAGIC:
        return "mdf"  # MDF 3 files often have the suffix .dat, as text tables do
    if suffix == ".asc" and head.strip() and not CAN_ASC.search(head):
        return "csv"
    return next((kind for kind, suffixes in SUFFIXES.items() if suffix in suffixes), "")


def _open_json(path: Path, mapping: DynoMapping) -> LogTable | TimedLog:
    return _table_or_series(path, mapping, json.loads(path.read_bytes()))


def _open_mat(path: Path, mapping: DynoMapping) -> LogTable | TimedLog:
    if not is_mat73(path):
        return _table_or_series(path, mapping, _load_mat(path))
    return _table_or_series(path, mapping, open_mat73(path))


def _load_mat(path: Path) -> dict[str, Any]:
    """Return the variables of a MAT file up to version 7."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MatReadWarning)  # scipy before 1.18 gives all objects one name
        tree: dict[str, Any] = scipy.io.loadmat(path, simplify_cells=True)
        if any(isinstance(value, MatlabOpaque) for value in tree.values()):
            with path.open("rb") as file:
                parts = [scipy.io.loadmat(part, simplify_cells=True) for _, part in varmats_from_mat(file)]
            tree = {name: value for part in parts for name, value in replace_objects(part).items()}
    return tree


def _table_or_series(path: Path, mapping: DynoMapping, tree: Any) -> LogTable | TimedLog:
    """Return the series if the mapping gives no time and its columns are series, else the table."""
    root = follow_route(path, tree, mapping.rows)
    columns = [source for source in mapping.signals.values() if isinstance(source, Column)]
    if mapping.time is None and mapping.rate is None and isinstance(root, Mapping):
        listed = dict(list_series(root))
        if columns and all(str(c.key) in listed or find_series(follow_route(path, root, str(c.key))) for c in columns):
            return TreeSeries(path, root)
        if not columns and listed:
            return TreeSeries(path, root)
    return TreeTable(path, mapping, tree)


READERS: dict[str, Callable[[Path, DynoMapping], LogTable | TimedLog]] = {
    "json": _open_json,
    "mat": _open_mat,
    "mdf": lambda path, mapping: CanLog(path, mapping) if mapping.dbc else MdfLog(path),
    "bag": lambda path, _: BagLog(path),
    "can": CanLog,
    "parquet": ParquetTable,
}
