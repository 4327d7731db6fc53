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
MAX_BYTES = 4_000_000_000  # of one variable in memory


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

    def _require_readable(self, name: str, item: Any) -> None:
        """Raise RecordingError for numbers that are in other files, or that are more than fit into memory."""
        if item.external or item.is_virtual:
            raise RecordingError(f"{self._path}: the numbers of '{name}' are in another file; save all into one")
        size = item.size * item.dtype.itemsize
        if size > MAX_BYTES:
            raise RecordingError(
                f"{self._path}: '{name}' states {item.size} numbers, {size / 1e9:.3g} GB; expected at most "
                f"{MAX_BYTES / 1e9:g} GB: save the signals alone, or in parts"
            )
