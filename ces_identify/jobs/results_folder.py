"""The results of many jobs in a folder: a line of JSON for each job as it ends, and the job's files."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from ces_identify.jobs.job import DONE, FAILED, Job, JobResult
from ces_identify.jobs.row_log import Row, RowLog, open_rows
from ces_observer.json_checks import write_all_atomically


class ResultsFolder:
    """The rows of jobs by key, and the files they belong to; made by `open_results`."""

    def __init__(self, folder: Path, log: RowLog) -> None:
        self.folder = folder
        self._log = log

    @property
    def rows(self) -> dict[str, Row]:
        """The rows of finished and failed jobs, by key."""
        return self._log.rows

    def has(self, job: Job) -> bool:
        """Return whether the job need not run: it is done and its output exists, or it failed for good."""
        status = self.rows.get(job.key, {}).get("status")
        return status == FAILED or (status == DONE and (self.folder / job.output).exists())

    def add(self, result: JobResult) -> None:
        """Write the files, then the row that says they exist. Raises CesError or OSError if the disk is full."""
        files = {self.folder / name: text for name, text in result.files.items()}
        for parent in {path.parent for path in files}:
            parent.mkdir(parents=True, exist_ok=True)
        write_all_atomically(files)
        self._log.add(result.row)

    def refresh(self) -> None:
        """Read the rows from the file again, after Ctrl-C that may have come in the middle of `add`."""
        self._log.refresh()


@contextlib.contextmanager
def open_results(path: Path, kind: str) -> Iterator[ResultsFolder]:
    """Open the rows at `path`, results of `kind` ("a campaign"), and hold them against a second run.

    The folder is made if need be. Raises CesError if it cannot be, if another run holds the rows, or if a line that is
    not the last cannot be read.
    """
    with open_rows(path, kind) as log:
        yield ResultsFolder(path.parent, log)
