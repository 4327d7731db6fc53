"""A file of rows: one line of JSON each, appended and flushed, safe against a kill at any moment and a second run."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from ces_observer.errors import CesError
from ces_observer.json_text import write_all_atomically

Row = dict[str, Any]
DONE, FAILED, CRASHED = "done", "failed", "crashed"


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


class Job(Protocol):
    """A job; two jobs have the same key if they have the same result."""

    @property
    def key(self) -> str:
        """The key of the job's row."""

    @property
    def identity(self) -> Row:
        """The columns that identify the job in a row, including its key."""

    @property
    def output(self) -> str:
        """The file or folder that a finished job writes, relative to the results folder."""


@dataclass(frozen=True)
class JobResult:
    """The row of a job, and the texts of its files by their path relative to the results folder."""

    row: Row
    files: Mapping[str, str] = field(default_factory=dict)


def run_job(job: Job, work: Callable[[], JobResult]) -> JobResult:
    """Return the result of `work`. A CesError makes the job `failed`, any other error `crashed`.

    A failed job is not repeated; a crashed one is repeated by the next run.
    """
    try:
        return work()
    except CesError as error:
        return failed_job(job, FAILED, str(error))
    except Exception as error:  # one job must not stop the others
        return failed_job(job, CRASHED, describe_error(error))


def failed_job(job: Job, status: str, reason: str) -> JobResult:
    """Return the result of a failed or crashed job."""
    return JobResult({**job.identity, "status": status, "reason": reason})


def describe_error(error: BaseException) -> str:
    """Return an error's class and message in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


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
