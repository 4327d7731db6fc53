"""MATLAB 7.3 files: HDF5 with MATLAB's conventions, as nested mappings whose arrays are read when they are used.

MATLAB stores arrays transposed, structures as groups, arrays of structures and cells as references, and texts and
logicals as numbers with the attribute MATLAB_class. Objects (`timeseries`, `timetable`, `table`) have a form of their
own, which is not read.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ces_identify.recordings.formats.log_file import import_reader
from ces_identify.recordings.formats.matlab_objects import MatlabObject
from ces_observer.errors import RecordingError

HEAD = b"MATLAB 7.3"


def is_mat73(path: Path) -> bool:
    """Return whether the file begins as MATLAB's HDF5 files do."""
    with path.open("rb") as file:
        return file.read(len(HEAD)) == HEAD


def open_mat73(path: Path) -> Mapping[str, Any]:
    """Open a file as a nested mapping, which keeps it open.

    Raises RecordingError if it is damaged or h5py is missing.
    """
    h5py = import_reader("h5py", "h5py", "mat73", path)
    try:
        return _Structure(path, h5py.File(path, "r"), h5py)
    except OSError as error:
        raise RecordingError(f"{path}: not a MATLAB 7.3 file, or damaged: {error}") from None


class _Structure(Mapping[str, Any]):
    """A structure or the file itself; fields are read when they are asked for."""

    def __init__(self, path: Path, group: Any, h5py: Any) -> None:
        self._path, self._group, self._h5py = path, group, h5py

    def __iter__(self) -> Iterator[str]:
        return (name for name in self._group if not name.startswith("#"))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __getitem__(self, name: str) -> Any:
        if name not in self._group:
            raise KeyError(name)
        return self._convert(name, self._group[name])

    def _convert(self, name: str, item: Any) -> Any:
        if isinstance(item, self._h5py.Group):
            return _Structure(self._path, item, self._h5py)
        kind = item.attrs.get("MATLAB_class", b"")
        kind = kind.decode() if isinstance(kind, bytes) else str(kind)
        if "MATLAB_object_decode" in item.attrs:
            return MatlabObject(kind)
        if item.attrs.get("MATLAB_empty", 0):
            return np.empty(0)
        if item.dtype == self._h5py.ref_dtype:
            return [self._convert(name, self._group.file[reference]) for reference in item[()].T.ravel()]
        values = item[()].T
        return "".join(map(chr, values.T.ravel())) if kind == "char" else np.asarray(values).squeeze()
