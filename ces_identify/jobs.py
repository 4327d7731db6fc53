"""Runs many jobs, saves each result as a row and files as soon as the job ends, and resumes after an interruption.

Campaigns of identifications and fleets of diagnoses run on this engine, in processes of one machine or on the workers
of a Dask cluster; Dask is an optional dependency and is imported only when a cluster is used. A file of rows holds one
line of JSON each, appended and flushed: it is safe against a kill at any moment and a second run.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import signal
import socket
from collections.abc import Callable, Generator, Hashable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO, Protocol, TypeVar

from ces_observer import __version__
from ces_observer.errors import CesError
from ces_observer.json_text import write_all_atomically

Row = dict[str, Any]
DONE, FAILED, CRASHED = "done", "failed", "crashed"
CONNECT_S = 10.0
TASKS_AHEAD = 2  # tasks sent ahead per thread of a cluster


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
    """Return the result of `work`; a CesError makes it `failed` for good, any other error `crashed`, to be repeated."""
    try:
        return work()
    except CesError as error:
        return failed_job(job, FAILED, str(error))
    except Exception as error:  # one job must not stop the others
        logging.getLogger(__name__).exception("%s", job.output)
        return failed_job(job, CRASHED, _describe_error(error))


def failed_job(job: Job, status: str, reason: str) -> JobResult:
    """Return the result of a failed or crashed job."""
    return JobResult({**job.identity, "status": status, "reason": reason})


def _describe_error(error: BaseException) -> str:
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
    """Write a row; raises OSError if the disk is full."""
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
        """Write the files, then the row. Raises CesError or OSError if the disk is full."""
        files = {self.folder / name: text for name, text in result.files.items()}
        for path in files:
            path.parent.mkdir(parents=True, exist_ok=True)
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

    ordered = tuple(map(int, joblib.__version__.split(".")[:2])) < (1, 4)
    with joblib.parallel_config(backend="loky", inner_max_num_threads=threads):
        pool = joblib.Parallel(
            n_jobs=max(2, processes),  # with 1, joblib would use this process, where Ctrl-C stops the search
            pre_dispatch=processes,
            batch_size=1,
            return_as="generator" if ordered else "generator_unordered",
        )
        try:
            yield from pool(joblib.delayed(_run_in_process)(function, *task) for task in tasks)
        except BrokenProcessPool as error:
            if error.__cause__ is None:
                text = "died, perhaps short of memory; finished results are kept: run again with fewer --jobs"
            else:
                text = str(error.__cause__).strip(' \n"').rpartition("\n")[2]
                text = f"could not read its task or return its result ({text})"
            raise CesError(f"a worker process {text}") from None


def _run_in_process(function: Callable[..., Result], *arguments: Any) -> Result:
    """Compute in a worker process, and leave Ctrl-C, which the terminal sends to all processes, to the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return function(*arguments)


def run_on_cluster(work: Work, tasks: Iterable[Task], shared: Shared, address: str) -> Generator[JobResult, None, None]:
    """Yield the result of each task as it ends, from the workers of the Dask scheduler at `address`.

    Each shared object is sent to every worker once; tasks are taken from `tasks` as workers become free. Raises
    CesError if the cluster cannot be used or is lost.
    """
    distributed = _import_dask()
    with contextlib.closing(_connect(distributed, address)) as client:
        _require_same_version(client, address)
        remote = dict(zip(shared, client.scatter(list(shared.values()), broadcast=True, hash=False), strict=True))
        ended = distributed.as_completed(loop=client.loop, raise_errors=False)
        waiting, sent = iter(tasks), {}

        def send(count: int) -> None:
            for _, task in zip(range(count), waiting, strict=False):
                own = client.scatter(list(task.own), hash=False) if task.own else []
                future = client.submit(work, task.job, [remote[key] for key in task.shared], own, pure=False)
                sent[future] = task.job
                ended.add(future)

        send(TASKS_AHEAD * sum(client.nthreads().values()))
        for future in ended:
            job = sent.pop(future)
            if future.status not in ("finished", "error"):
                raise CesError(
                    f"--dask {address}: the connection to the cluster was lost; finished results are kept: run again"
                )
            good = future.status == "finished"
            yield future.result() if good else failed_job(job, CRASHED, _describe_error(future.exception()))
            future.release()
            send(1)


def _import_dask() -> Any:
    """Return dask.distributed with its log silenced, which would hide our one line about a lost cluster."""
    try:
        distributed = import_module("distributed")
    except ImportError:
        raise CesError("--dask needs dask.distributed: pip install 'ces_observer[dask]'") from None
    for handler in logging.getLogger("distributed").handlers:
        handler.setLevel(logging.CRITICAL + 1)
    return distributed


def _connect(distributed: Any, address: str) -> Any:
    """Return a client of the scheduler; a plain connection is tried first: a failed client closes slowly."""
    host, _, port = address.rpartition("://")[2].rpartition(":")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), CONNECT_S):
            pass
        return distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError):
        raise CesError(
            f"--dask {address}: no scheduler answered within {CONNECT_S:g} s; expected the host:port of a running one"
        ) from None


def _require_same_version(client: Any, address: str) -> None:
    """Raise CesError unless there are workers, all with this version of the package."""
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
        versions = client.run(_version)
    except Exception as error:  # any error that keeps a worker from importing this module
        raise CesError(
            f"--dask {address}: no workers that can run ces_observer {__version__}; start some there: "
            f"dask worker {address} ({_describe_error(error)})"
        ) from None
    for worker, version in versions.items():
        if version != __version__:
            raise CesError(f"--dask {address}: worker {worker} has ces_observer {version}; install {__version__} there")


def _version() -> str:
    return __version__
