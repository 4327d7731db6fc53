"""The answers of a fleet on disk: a line of JSON for each unit as it ends, and its files in a folder of its own."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from ces_gap.fleet.answer import DONE, FAILED, Answer
from ces_gap.fleet.question import Job
from ces_identify.jobs.row_log import Row, RowLog, open_rows
from ces_observer.checked import write_together

ROWS = "fleet.jsonl"


class Fleet:
    """The rows of a fleet by key and the folders they tell of; made by `open_fleet`."""

    def __init__(self, folder: Path, log: RowLog) -> None:
        self.folder = folder
        self._log = log

    @property
    def rows(self) -> dict[str, Row]:
        """The rows that are there, by key."""
        return self._log.rows

    def has(self, job: Job) -> bool:
        """True if the unit need not be diagnosed: it is and its files are there, or it failed for good."""
        status = self.rows.get(job.key, {}).get("status")
        return status == FAILED or (status == DONE and job.folder.is_dir())

    def add(self, job: Job, given: Answer) -> None:
        """Write the files, then the row that says they are there. Raises CesError or OSError if the disk is full."""
        if given.files:
            job.folder.mkdir(parents=True, exist_ok=True)
            write_together({job.folder / name: text for name, text in given.files.items()})
        self._log.add(given.row)

    def refresh(self) -> None:
        """Take the rows from the file again, after Ctrl-C."""
        self._log.refresh()


@contextlib.contextmanager
def open_fleet(folder: Path) -> Iterator[Fleet]:
    """Open the rows in `folder`, which is made if need be, and hold them against a second run. Raises CesError."""
    with open_rows(folder / ROWS, "a fleet") as log:
        yield Fleet(folder, log)
