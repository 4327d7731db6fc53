"""Rows of results on disk: a line of JSON for each as it comes, safe against a kill at any moment and a second run.

The file is only ever appended to, each line flushed to the disk; what a kill left of a last line is dropped by the next
run.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from ces_observer.errors import CesError

Row = dict[str, Any]


class RowLog:
    """Rows by their key, in memory and in an open file of which they are the lines; made by `open_rows`."""

    def __init__(self, path: Path, file: BinaryIO, kind: str, rows: dict[str, Row]) -> None:
        self.path, self.kind, self.rows = path, kind, rows
        self._file = file

    def add(self, row: Row) -> None:
        """Write a row with a `key`. Raises OSError if the disk is full."""
        self._file.write(json.dumps(row, allow_nan=False, ensure_ascii=False).encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())
        self.rows[row["key"]] = row

    def refresh(self) -> None:
        """Take the rows from the file again, after Ctrl-C that may have come in the middle of `add`."""
        self._file.flush()
        self._file.seek(0)
        self.rows = _rows(self._file.read().rpartition(b"\n")[0], self.path, self.kind)


@contextlib.contextmanager
def open_rows(path: Path, kind: str) -> Iterator[RowLog]:
    """Open the rows at `path`, results of `kind` ("a campaign"), and hold them against a second run.

    The folder is made if need be. Raises CesError if it cannot be, if another run holds the rows, or if a line that is
    not the last cannot be read.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("ab+")
    except OSError as error:
        raise CesError(f"{path.parent}: cannot be written: {error.strerror}; choose another folder") from None
    with file:
        _hold(file, path.parent)
        file.seek(0)
        whole, _, torn = file.read().rpartition(b"\n")
        if torn:
            file.truncate(len(whole) + 1 if whole else 0)
        yield RowLog(path, file, kind, _rows(whole, path, kind))


def _rows(whole: bytes, path: Path, kind: str) -> dict[str, Row]:
    rows = {}
    for number, line in enumerate(whole.splitlines(), start=1):
        try:
            row = json.loads(line)
            rows[row["key"]] = row
        except (ValueError, KeyError, TypeError):
            raise CesError(f"{path}:{number}: is not a result of {kind}; remove the line") from None
    return rows


def _hold(file: BinaryIO, folder: Path) -> None:
    """Lock the file until it is closed, where the system can."""
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise CesError(f"{folder}: another run is writing there; wait for it or choose another folder") from None
    except OSError:  # a file system without locks
        return
