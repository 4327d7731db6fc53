"""Runs many jobs, saves each result as a row and files as soon as the job ends, and resumes after an interruption.

Campaigns of identifications and fleets of diagnoses run on this engine, in processes of one machine. A file of rows
holds one line of JSON each, appended and flushed: it is safe against a kill at any moment and a second run.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import logging
import os
import signal
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Generator, Hashable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any, BinaryIO, NoReturn, Protocol, TypeVar

from ces_observer.errors import CesError, OptionName, Wording
from ces_observer.json_text import explain_write_errors, write_all_atomically

Row = dict[str, Any]
DONE, FAILED, CRASHED = "done", "failed", "crashed"
POLL_S, EXIT_S = 1.0, 5.0


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


def run_job(job: Job, work: Callable[[], JobResult], wording: Wording) -> JobResult:
    """Return the result of `work`; a CesError makes it `failed` for good, any other error `crashed`, to be repeated.

    `wording` is how the user who reads the reason writes options.
    """
    try:
        return work()
    except CesError as error:
        return failed_job(job, FAILED, error.word(wording))
    except Exception as error:  # one job must not stop the others
        logging.getLogger(__name__).exception("%s", job.output)
        return failed_job(job, CRASHED, describe_error(error))


def failed_job(job: Job, status: str, reason: str) -> JobResult:
    """Return the result of a failed or crashed job."""
    return JobResult({**job.identity, "status": status, "reason": reason})


def describe_error(error: BaseException) -> str:
    """Return the kind and text of an error on one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


@contextlib.contextmanager
def open_rows(path: Path) -> Iterator[BinaryIO]:
    """Open and lock the rows at `path` (made if needed) without an incomplete last line; raises CesError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("ab+")
    except OSError as error:
        raise CesError(f"{path.parent}: cannot be written: {error.strerror}; choose another folder") from None
    with file:
        with contextlib.suppress(ImportError, OSError):  # a system or a file system without locks
            _lock(file, path.parent)
        file.seek(0)
        whole, _, rest = file.read().rpartition(b"\n")
        if rest:
            file.truncate(len(whole) + 1 if whole else 0)
        yield file


def _lock(file: BinaryIO, folder: Path) -> None:
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise CesError(f"{folder}: another run is writing there; wait for it or choose another folder") from None


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
    """Write a row; raises CesError if the disk is full."""
    with explain_write_errors(Path(file.name)):
        file.write(json.dumps(row, allow_nan=False, ensure_ascii=False).encode() + b"\n")
        file.flush()
        os.fsync(file.fileno())


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
        """Write the files, then the row. Raises CesError if the disk is full, which says what is kept."""
        files = {self.folder / name: text for name, text in result.files.items()}
        try:
            for path in files:
                with explain_write_errors(path):
                    path.parent.mkdir(parents=True, exist_ok=True)
            write_all_atomically(files)
            append_row(self._file, result.row)
        except CesError as error:
            done = sum(row["status"] == DONE for row in self.rows.values())
            raise CesError(f"{error}; {done} finished results are kept in {self.folder}") from None
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


Result = TypeVar("Result")
Shared = Mapping[Any, Any]  # objects that several tasks need, by key


@dataclass(frozen=True)
class Task:
    """A job, the keys of the shared objects that it needs, and its own objects."""

    job: Job
    shared: Sequence[Hashable]
    own: Sequence[Any] = ()


Work = Callable[..., JobResult]  # (job, shared objects, own objects)


def run_on_this_machine(
    work: Work, tasks: Iterable[Task], shared: Shared, processes: int, threads: int
) -> Generator[JobResult, None, None]:
    """Yield the result of each task as it ends; raises CesError if a process dies."""
    arguments = ((task.job, [shared[key] for key in task.shared], list(task.own)) for task in tasks)
    return run_in_processes(work, arguments, processes, threads)


def run_in_processes(
    function: Callable[..., Result], tasks: Iterable[tuple[Any, ...]], processes: int, threads: int
) -> Generator[Result, None, None]:
    """Yield the result of `function` for each task's arguments as it ends.

    A task is taken from `tasks`, perhaps in another thread, when a process is free. Raises CesError if a process dies.
    """
    import joblib  # type: ignore[import-untyped]

    warnings.filterwarnings("ignore", r"\d+ tasks which were", UserWarning)  # are cancelled, as was wanted
    ordered = tuple(map(int, joblib.__version__.split(".")[:2])) < (1, 4)
    folders = tempfile.TemporaryDirectory(prefix="ces_jobs_", ignore_cleanup_errors=True)  # joblib kills its workers
    with folders as folder, joblib.parallel_config(backend="loky", inner_max_num_threads=threads):
        pool = joblib.Parallel(
            n_jobs=max(2, processes),  # with 1, joblib would use this process, where Ctrl-C stops the search
            pre_dispatch=processes,
            batch_size=1,
            return_as="generator" if ordered else "generator_unordered",
        )
        try:
            yield from pool(joblib.delayed(_run_in_process)(os.getpid(), folder, function, *task) for task in tasks)
        except BrokenProcessPool as error:
            if error.__cause__ is None:
                text = (
                    "a worker process died, perhaps short of memory; finished results are kept: run again with fewer "
                )
                raise CesError(text, OptionName("jobs")) from None
            text = str(error.__cause__).strip(' \n"').rpartition("\n")[2]
            raise CesError(f"a worker process could not read its task or return its result ({text})") from None


def _run_in_process(parent: int, folder: str, function: Callable[..., Result], *arguments: Any) -> Result:
    _follow(parent, folder)
    return function(*arguments)


@cache
def _follow(parent: int, folder: str) -> None:
    """Leave Ctrl-C, which the terminal sends to all processes, to the parent; end with it, even if it was killed.

    Temporary files are made in `folder`, which the parent removes.
    """
    tempfile.tempdir = folder
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, end_process)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(POLL_S)
    os.kill(os.getpid(), signal.SIGTERM)


def end_process(number: int, frame: FrameType | None = None) -> NoReturn:
    """Handle the signal `number`: remove temporary files, end the workers and this process, without waiting for them.

    Temporary folders of the standard library and joblib remove themselves at exit; so do half-written files here.
    """
    signal.signal(number, signal.SIG_IGN)
    end = threading.Timer(EXIT_S, os._exit, (128 + number,))  # if a library waits at exit
    end.daemon = True
    end.start()
    _end_children()
    atexit._run_exitfuncs()  # `sys.exit` would first wait for the threads of a search
    os._exit(128 + number)


def _end_children() -> None:
    """Send SIGTERM to the processes that this one has started; to none without /proc."""
    for path in Path("/proc/self/task").glob("*/children"):
        for pid in path.read_text().split() if path.exists() else ():
            with contextlib.suppress(OSError):
                os.kill(int(pid), signal.SIGTERM)
