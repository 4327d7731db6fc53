"""MATLAB files: up to version 7 with scipy; 7.3, which is HDF5, as nested mappings whose arrays are read when used.

MATLAB 7.3 stores arrays transposed, structures as groups, arrays of structures and cells as references, and texts and
logicals as numbers with the attribute MATLAB_class. Objects (`timeseries`, `timetable`, `table`) have a form of their
own, which is not read.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
from scipy.io.matlab import MatlabOpaque, MatReadWarning, varmats_from_mat

from ces_data.logs.json import open_tree
from ces_data.logs.log_file import LogTable, Progress, TimedLog, import_reader
from ces_data.logs.log_mapping import DynoMapping
from ces_data.logs.matlab_objects import MatlabObject
from ces_observer.errors import RecordingError

SYSTEM = "MCOS"  # MATLAB's class system, beside the class in what scipy reads
HEAD = b"MATLAB 7.3"
MAX_BYTES = 4_000_000_000  # of one variable in memory


def open_log(path: Path, mapping: DynoMapping, _: Progress) -> LogTable | TimedLog:
    """Read a MATLAB file; raises RecordingError if it is damaged or a library is missing."""
    with path.open("rb") as file:
        head = file.read(len(HEAD))
    if head == HEAD:
        return open_tree(path, mapping, open_mat73(path))
    if head.startswith(b"\x89HDF"):
        raise RecordingError(f"{path}: is an HDF5 file that MATLAB did not write; write CSV or Parquet")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MatReadWarning)  # scipy before 1.18 gives all objects one name
        try:
            tree: dict[str, Any] = scipy.io.loadmat(path, simplify_cells=True)
        except TypeError as error:  # by scipy, of a damaged file
            raise ValueError(error) from None
        if any(isinstance(value, MatlabOpaque) for value in tree.values()):
            with path.open("rb") as file:
                parts = [scipy.io.loadmat(part, simplify_cells=True) for _, part in varmats_from_mat(file)]
            tree = {name: value for part in parts for name, value in replace_objects(part).items()}
    return open_tree(path, mapping, tree)


def replace_objects(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Return the variables of a file that scipy read, its objects as `MatlabObject` by their own names."""
    found: dict[str, Any] = {}
    for name, value in tree.items():
        if not isinstance(value, MatlabOpaque):
            found[str(name)] = value
            continue
        cells = [cell for cell in value.ravel()[0] if isinstance(cell, bytes | str)]
        texts = [cell.decode() if isinstance(cell, bytes) else cell for cell in cells]
        own = [text for text in texts if text != SYSTEM]  # its name, which scipy 1.18 gives elsewhere; its class
        found[own[0] if len(own) > 1 else str(name)] = MatlabObject(own[-1])
    return found


def open_mat73(path: Path) -> Mapping[str, Any]:
    """Open a file as a nested mapping, which keeps it open; raises RecordingError if damaged or without h5py."""
    h5py = import_reader("h5py", path)
    try:
        return _Structure(path, h5py.File(path, "r"), h5py)
    except OSError as error:
        raise RecordingError(f"{path}: not a MATLAB 7.3 file, or damaged: {error}") from None


class _Structure(Mapping[str, Any]):
    """A structure or the file itself; fields are read when they are asked for."""

    def __init__(self, path: Path, group: Any, h5py: Any) -> None:
        self._path, self._group, self._h5py = path, group, h5py

    def __iter__(self) -> Iterator[str]:
        return (name for name in self._group if not name.startswith("#") and not self._is_external(name))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __getitem__(self, name: str) -> Any:
        if name not in self._group:
            raise KeyError(name)
        if self._is_external(name):
            raise RecordingError(f"{self._path}: '{name}' is a link to another file; save all variables into one")
        return self._convert(name, self._group[name])

    def _is_external(self, name: str) -> bool:
        return isinstance(self._group.get(name, getlink=True), self._h5py.ExternalLink)

    def _convert(self, name: str, item: Any) -> Any:
        if isinstance(item, self._h5py.Group):
            fields = list(item.values())
            if fields and all(isinstance(f, self._h5py.Dataset) and self._is_field(f) for f in fields):
                parts = [
                    [self._convert(name, f) for f in map(item.file.__getitem__, field[()].T.ravel())]
                    for name, field in item.items()
                ]
                return [dict(zip(item, values, strict=True)) for values in zip(*parts, strict=True)]
            return _Structure(self._path, item, self._h5py)
        kind = item.attrs.get("MATLAB_class", b"")
        kind = kind.decode() if isinstance(kind, bytes) else str(kind)
        if "MATLAB_object_decode" in item.attrs:
            return MatlabObject(kind)
        if item.attrs.get("MATLAB_empty", 0):
            return np.empty(0)
        self._require_readable(name, item)
        if item.dtype == self._h5py.ref_dtype:
            return [self._convert(name, self._group.file[reference]) for reference in item[()].T.ravel()]
        values = item[()].T
        return "".join(map(chr, values.T.ravel())) if kind == "char" else np.asarray(values).squeeze()

    def _is_field(self, item: Any) -> bool:
        """Return whether a dataset holds a field of an array of structures: references, of no class."""
        return bool(item.dtype == self._h5py.ref_dtype) and "MATLAB_class" not in item.attrs

    def _require_readable(self, name: str, item: Any) -> None:
        """Raise RecordingError for numbers that are in other files, or that are more than fit into memory."""
        if item.external or item.is_virtual:
            raise RecordingError(f"{self._path}: the numbers of '{name}' are in another file; save all into one")
        size = item.size * item.dtype.itemsize
        if size > MAX_BYTES:
            has = f"'{name}' states {item.size} numbers, {size / 1e9:.3g} GB"
            remedy = f"expected at most {MAX_BYTES / 1e9:g} GB: save the signals alone, or in parts"
            raise RecordingError(f"{self._path}: {has}; {remedy}")
