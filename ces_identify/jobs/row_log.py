"""A file of rows: one line of JSON each, appended and flushed, safe against a kill at any moment and a second run."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from ces_observer.errors import CesError

Row = dict[str, Any]


@contextlib.contextmanager
def open_rows(path: Path) -> Iterator[BinaryIO]:
    """Open and lock the file at `path`, make its folder if needed, and drop an incomplete last line.

    Raises CesError if it cannot be written or another run has locked it.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("ab+")
    except OSError as error:
        raise CesError(f"{path.parent}: cannot be written: {error.strerror}; choose another folder") from None
    with file:
        _lock(file, path.parent)
        file.seek(0)
        whole, _, rest = file.read().rpartition(b"\n")
        if rest:
            file.truncate(len(whole) + 1 if whole else 0)
        yield file


def read_rows(file: BinaryIO, path: Path, kind: str) -> dict[str, Row]:
    """Return the rows in complete lines by their `key`; raises CesError naming a line that is not a row."""
    file.flush()
    file.seek(0)
    rows = {}
    for number, line in enumerate(file.read().rpartition(b"\n")[0].splitlines(), start=1):
        try:
            row = json.loads(line)
            rows[row["key"]] = row
        except (ValueError, KeyError, TypeError):
            raise CesError(f"{path}:{number}: is not a result of {kind}; remove the line") from None
    return rows


def append_row(file: BinaryIO, row: Row) -> None:
    """Write a row; raises OSError if the disk is full."""
    file.write(json.dumps(row, allow_nan=False, ensure_ascii=False).encode() + b"\n")
    file.flush()
    os.fsync(file.fileno())


def _lock(file: BinaryIO, folder: Path) -> None:
    """Lock the file until it is closed, if the system can."""
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
