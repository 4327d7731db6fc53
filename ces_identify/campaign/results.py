"""The results of a campaign on disk: a line of JSON for each cell as it ends, and its model beside.

`results.jsonl` is only ever appended to, each line flushed to the disk, so that a run may be killed at any moment; what
a kill left of a last line is dropped by the next run.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from ces_identify.campaign.cell import DONE, FAILED, Outcome, Row
from ces_observer.checked import write_beside
from ces_observer.errors import CesError

FILE = "results.jsonl"


class Results:
    """The rows of a campaign by key, in memory and in an open file; made by `open_results`."""

    def __init__(self, folder: Path, file: BinaryIO, rows: dict[str, Row]) -> None:
        self.folder, self.rows = folder, rows
        self._file = file

    def model(self, key: str) -> Path:
        """Return where the model of a cell is, or would be."""
        return self.folder / "models" / f"{key}.json"

    def has(self, key: str) -> bool:
        """True if the cell need not be computed: it is done and its model there, or it failed for good."""
        status = self.rows.get(key, {}).get("status")
        return status == FAILED or (status == DONE and self.model(key).exists())

    def add(self, outcome: Outcome) -> None:
        """Write the model, then the row that says it is there. Raises CesError or OSError if the disk is full."""
        key = outcome.row["key"]
        if outcome.model is not None:
            write_beside(self.model(key), outcome.model)
        self._file.write(json.dumps(outcome.row, allow_nan=False, ensure_ascii=False).encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())
        self.rows[key] = outcome.row

    def refresh(self) -> None:
        """Take the rows from the file again, after Ctrl-C that may have come in the middle of `add`."""
        self._file.flush()
        self._file.seek(0)
        self.rows = _rows(self._file.read().rpartition(b"\n")[0], self.folder / FILE)


@contextlib.contextmanager
def open_results(folder: Path) -> Iterator[Results]:
    """Open the results in `folder`, which is made if need be, and hold them against a second run.

    Raises CesError if another run holds them, or if a line that is not the last cannot be read.
    """
    path = folder / FILE
    try:
        (folder / "models").mkdir(parents=True, exist_ok=True)
        file = path.open("ab+")
    except OSError as error:
        raise CesError(f"{folder}: cannot be written: {error.strerror}; choose another folder") from None
    with file:
        _hold(file, folder)
        file.seek(0)
        whole, _, torn = file.read().rpartition(b"\n")
        if torn:
            file.truncate(len(whole) + 1 if whole else 0)
        yield Results(folder, file, _rows(whole, path))


def _rows(whole: bytes, path: Path) -> dict[str, Row]:
    rows = {}
    for number, line in enumerate(whole.splitlines(), start=1):
        try:
            row = json.loads(line)
            rows[row["key"]] = row
        except (ValueError, KeyError, TypeError):
            raise CesError(f"{path}:{number}: is not a result of a campaign; remove the line") from None
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
