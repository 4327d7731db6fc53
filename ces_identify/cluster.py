"""Jobs on the workers of a Dask cluster. Workers and the scheduler may end and come back: nothing is lost.

Dask is an optional dependency and is imported only when a cluster is used.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import platform
import queue
import socket
import time
import warnings
from collections.abc import Callable, Generator, Hashable, Iterable, Iterator
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from importlib import import_module
from itertools import chain, islice
from typing import Any

from ces_identify.jobs import CRASHED, POLL_S, Job, JobResult, Shared, Task, Work, describe_error, failed_job
from ces_observer import __version__
from ces_observer.errors import CesError

CONNECT_S = 10.0
RETURN_S = 300.0  # for so long a scheduler that went away, or its workers, may take to come back
TASKS_AHEAD = 2  # tasks sent ahead per thread of a cluster


def run_on_cluster(
    work: Work, tasks: Iterable[Task], shared: Shared, address: str, note: Callable[[str], None] = lambda text: None
) -> Generator[JobResult, None, None]:
    """Yield the result of each task as it ends, from the workers of the Dask scheduler at `address`.

    Each shared object is sent once; tasks are taken from `tasks` as workers become free. What a worker or a scheduler
    that ended had not finished is computed again; `note` receives a line if there are no workers, or no scheduler.
    Raises CesError if the cluster cannot be used, or does not come back.
    """
    waiting, patience_s = iter(tasks), CONNECT_S
    warnings.filterwarnings("ignore", "Sending large graph", UserWarning)  # recordings
    while True:
        with contextlib.closing(_connect(address, patience_s)) as client:
            _require_same_version(client, address, patience_s)
            run = _ClusterRun(client, f"--dask {address}", work, shared, note)
            yield from run.results(waiting)
        if not (left := [*run.sent.values(), *run.unsent]):
            return
        waiting, patience_s = chain(left, waiting), RETURN_S
        note(f"--dask {address}: the connection was lost; waiting {RETURN_S:g} s for the scheduler and its workers")


@dataclass
class _ClusterRun:
    """Tasks on the workers that one connection reaches: `sent` by their futures, and `unsent` that were taken, too."""

    client: Any
    where: str  # for messages
    work: Work
    shared: Shared
    note: Callable[[str], None]
    remote: dict[Hashable, Any] = field(default_factory=dict)
    ended: queue.SimpleQueue[Any] = field(default_factory=queue.SimpleQueue)
    sent: dict[Any, Task] = field(default_factory=dict)
    unsent: list[Task] = field(default_factory=list)
    idle: bool = False

    def results(self, waiting: Iterator[Task]) -> Iterator[JobResult]:
        """Yield results until all tasks have one or the connection is lost; raises CesError."""
        while self.client.status == "running":
            self._send(waiting)
            if not self.sent and not self._take(waiting):
                return
            with contextlib.suppress(queue.Empty):
                future = self.ended.get(timeout=POLL_S)
                if (result := self._result(future)) is not None:
                    del self.sent[future]
                    yield result
                future.release()

    def _send(self, waiting: Iterator[Task]) -> None:
        """Send tasks while workers have room."""
        room = self._count_room()
        while len(self.sent) < room and self._take(waiting):
            try:
                self._submit(self.unsent[-1])
            except Exception:
                if self.client.status == "running":
                    raise
                return
            self.unsent.pop()

    def _take(self, waiting: Iterator[Task]) -> bool:
        """Return whether there is a task to send, perhaps a new one."""
        self.unsent.extend(islice(waiting, 0 if self.unsent else 1))
        return bool(self.unsent)

    def _count_room(self) -> int:
        """Return how many tasks the workers may have."""
        try:
            threads: int = sum(self.client.nthreads().values())
        except OSError:
            return 0
        if threads == 0 and not self.idle:
            self.note(f"{self.where}: no workers are left; waiting for new ones (Ctrl-C ends)")
        self.idle = threads == 0
        return TASKS_AHEAD * threads

    def _submit(self, task: Task) -> None:
        """Send a task; its objects are kept by the scheduler, so that Dask can run it again on another worker."""
        for key in task.shared:
            if key not in self.remote:
                self.remote[key] = self.client.submit(_hand_over, self.shared[key], pure=False)
        words = (_this_version(), self.work, task.job, [self.remote[key] for key in task.shared], list(task.own))
        future = self.client.submit(_run_on_worker, *words, pure=False)
        self.sent[future] = task
        future.add_done_callback(self.ended.put)

    def _result(self, future: Any) -> JobResult | None:
        """Return the result of a task; None if the connection is lost."""
        if future.status == "finished":
            with contextlib.suppress(asyncio.CancelledError, CancelledError):  # lost on its way
                found: JobResult = future.result()
                return found
        if future.status == "error":
            error = future.exception()
            if isinstance(error, CesError):
                text = f"{self.where}: {error}; finished results are kept: run the same command"
                raise CesError(text) from None
            return failed_job(self.sent[future].job, CRASHED, describe_error(error))
        self.unsent.append(self.sent.pop(future))
        return None


def _hand_over(value: Any) -> Any:
    return value


def _run_on_worker(versions: str, work: Work, job: Job, shared: list[Any], own: list[Any]) -> JobResult:
    """Compute a task; raises CesError on a worker of another version, which may have come after the start."""
    if (here := _this_version()) != versions:
        raise CesError(f"a worker on {socket.gethostname()} has {here}; expected {versions} as on this computer")
    return work(job, shared, own)


def _this_version() -> str:
    return f"ces_observer {__version__} and Python {'.'.join(platform.python_version_tuple()[:2])}"


def _import_dask() -> Any:
    """Return dask.distributed with its log silenced, which would hide our one line about a lost cluster."""
    try:
        distributed = import_module("distributed")
    except ImportError:
        raise CesError("--dask needs dask.distributed: pip install 'ces_observer[dask]'") from None
    for handler in logging.getLogger("distributed").handlers:
        handler.setLevel(logging.CRITICAL + 1)
    return distributed


def _connect(address: str, patience_s: float) -> Any:
    """Return a client of the scheduler; a plain connection is tried first: a failed client closes slowly."""
    distributed, end = _import_dask(), time.monotonic() + patience_s
    host, _, port = address.rpartition("://")[2].rpartition(":")
    while True:
        try:
            with socket.create_connection((host.strip("[]"), int(port)), CONNECT_S), warnings.catch_warnings():
                warnings.simplefilter("ignore")  # a table of versions; ours are compared
                return distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            if time.monotonic() > end or patience_s == CONNECT_S or not isinstance(error, OSError):
                raise CesError(
                    f"--dask {address}: no scheduler answered within {patience_s:g} s; expected the host:port of a "
                    "running one; finished results are kept"
                ) from None
            time.sleep(POLL_S)


def _require_same_version(client: Any, address: str, patience_s: float) -> None:
    """Raise CesError unless workers come in time, all with these versions of the package and of Python."""
    try:
        client.wait_for_workers(1, timeout=patience_s)
        versions = client.run(_this_version)
    except Exception as error:  # any error that keeps a worker from importing this module
        raise CesError(
            f"--dask {address}: no workers that can run ces_observer {__version__}; start some there: "
            f"dask worker {address} ({describe_error(error)})"
        ) from None
    for worker, version in versions.items():
        if version != _this_version():
            raise CesError(f"--dask {address}: worker {worker} has {version}; expected {_this_version()} as here")
