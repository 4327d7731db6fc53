"""The workers of a Dask cluster: an address in, a client whose workers have this version of the package out.

Dask is an optional dependency and is imported only when a cluster is used.
"""

from __future__ import annotations

import logging
import signal
import socket
from collections.abc import Callable, Generator, Hashable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, TypeVar

from ces_identify.jobs.results import CRASHED, Job, JobResult, describe_error, failed_job
from ces_observer import __version__
from ces_observer.errors import CesError

CONNECT_S = 10.0
TASKS_AHEAD = 2  # tasks sent ahead per thread of a cluster


@contextmanager
def open_cluster(address: str) -> Iterator[Any]:
    """Open a client of the Dask scheduler at `address`; raises CesError without workers of this package's version."""
    client = _connect(import_dask(), address)
    try:
        _require_same_version(client, address)
        yield client
    finally:
        client.close()


def import_dask() -> Any:
    """Return dask.distributed with its log silenced, which would hide our one line about a lost cluster."""
    try:
        distributed = import_module("distributed")
    except ImportError:
        raise CesError("--dask needs dask.distributed: pip install 'ces_observer[dask]'") from None
    for handler in logging.getLogger("distributed").handlers:
        handler.setLevel(logging.CRITICAL + 1)
    return distributed


def _connect(distributed: Any, address: str) -> Any:
    """Return a client of the scheduler; a plain connection is tried first, as a failed client is slow to close."""
    host, _, port = address.rpartition("://")[2].rpartition(":")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), CONNECT_S):
            pass
        client = distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError):
        raise CesError(
            f"--dask {address}: no scheduler answered within {CONNECT_S:g} s; expected the host:port of a running one"
        ) from None
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
    except OSError:
        client.close()
        raise CesError(f"--dask {address}: the scheduler has no workers; start some: dask worker {address}") from None
    return client


def _require_same_version(client: Any, address: str) -> None:
    try:
        versions = client.run(_version)
    except Exception as error:  # any error that keeps a worker from importing this module
        raise CesError(
            f"--dask {address}: its workers cannot run ces_identify; install ces_observer {__version__} there ({error})"
        ) from None
    for worker, version in versions.items():
        if version != __version__:
            raise CesError(f"--dask {address}: worker {worker} has ces_observer {version}; install {__version__} there")


def _version() -> str:
    return __version__


Result = TypeVar("Result")
Shared = Mapping[Any, Any]  # objects that several tasks need, by key


@dataclass(frozen=True)
class Task:
    """A job, the keys of the shared objects that it needs, and its own objects."""

    job: Job
    shared: Sequence[Hashable]
    own: Sequence[Any] = field(default_factory=tuple)


Work = Callable[..., JobResult]  # (job, shared objects, own objects)


def run_on_this_machine(
    work: Work, tasks: Iterable[Task], shared: Shared, processes: int, threads: int
) -> Generator[JobResult, None, None]:
    """Yield the result of each task as it ends; raises CesError if a process dies."""
    arguments = ((task.job, [shared[key] for key in task.shared], list(task.own)) for task in tasks)
    return run_in_processes(work, arguments, processes, threads)


def run_on_cluster(work: Work, tasks: Iterable[Task], shared: Shared, address: str) -> Generator[JobResult, None, None]:
    """Yield the result of each task as it ends, from the workers of the Dask scheduler at `address`.

    Each shared object is sent to every worker once; tasks are taken from `tasks` as workers become free. Raises
    CesError if the cluster cannot be used or is lost.
    """
    with open_cluster(address) as client:
        remote = dict(zip(shared, client.scatter(list(shared.values()), broadcast=True, hash=False), strict=True))
        ended = import_dask().as_completed(loop=client.loop, raise_errors=False)
        waiting, sent = iter(tasks), {}

        def send(count: int) -> None:
            for _, task in zip(range(count), waiting, strict=False):
                own = client.scatter(list(task.own), hash=False) if task.own else []
                future = client.submit(work, task.job, [remote[key] for key in task.shared], own, pure=False)
                sent[future] = task.job
                ended.add(future)

        send(TASKS_AHEAD * sum(client.nthreads().values()))
        for future in ended:
            job, reason = sent.pop(future), _reason_of_crash(future, address)
            yield future.result() if reason is None else failed_job(job, CRASHED, reason)
            future.release()
            send(1)


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
            raise _explain_broken_pool(error) from None


def _reason_of_crash(future: Any, address: str) -> str | None:
    """Return why a finished task has no result, None if it has one; raises CesError if the cluster is lost."""
    if future.status == "finished":
        return None
    if future.status != "error":
        raise CesError(
            f"--dask {address}: the connection to the cluster was lost; finished results are kept: run again"
        )
    return describe_error(future.exception())


def _explain_broken_pool(error: BrokenProcessPool) -> CesError:
    """Return the error for a broken process: one that could not read its task, or that died."""
    if error.__cause__ is not None:
        reason = str(error.__cause__).strip(' \n"').rpartition("\n")[2]
        return CesError(f"a worker process could not read its task or return its result ({reason})")
    return CesError(
        "a worker process died, perhaps short of memory; finished results are kept: run again with fewer --jobs"
    )


def _run_in_process(function: Callable[..., Result], *arguments: Any) -> Result:
    """Compute in a worker process, and leave Ctrl-C, which the terminal sends to all processes, to the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return function(*arguments)
