"""The results of many jobs in a folder: one line of JSON per finished job, and the job's files."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from ces_identify.jobs.job import DONE, FAILED, Job, JobResult
from ces_identify.jobs.row_log import append_row, open_rows, read_rows
from ces_observer.json_checks import write_all_atomically


class ResultsFolder:
    """The `rows` of finished and failed jobs by key, and their files; made by `open_results`."""

    def __init__(self, path: Path, file: BinaryIO, kind: str) -> None:
        self.folder = path.parent
        self._path, self._file, self._kind = path, file, kind
        self.refresh()

    def has(self, job: Job) -> bool:
        """Return whether the job need not run: it is done and its output exists, or it failed permanently."""
        status = self.rows.get(job.key, {}).get("status")
        return status == FAILED or (status == DONE and (self.folder / job.output).exists())

    def add(self, result: JobResult) -> None:
        """Write the files, then the row. Raises CesError or OSError if the disk is full."""
        files = {self.folder / name: text for name, text in result.files.items()}
        for parent in {path.parent for path in files}:
            parent.mkdir(parents=True, exist_ok=True)
        write_all_atomically(files)
        append_row(self._file, result.row)
        self.rows[result.row["key"]] = result.row

    def refresh(self) -> None:
        """Read the rows from the file again, after a Ctrl-C that may have interrupted `add`."""
        self.rows = read_rows(self._file, self._path, self._kind)


@contextlib.contextmanager
def open_results(path: Path, kind: str) -> Iterator[ResultsFolder]:
    """Open the rows at `path`, results of `kind` ("a campaign"), and lock them against a second run.

    The folder is made if needed. Raises CesError if that fails, if another run has locked the rows, or if a line other
    than the last cannot be read.
    """
    with open_rows(path) as file:
        yield ResultsFolder(path, file, kind)
