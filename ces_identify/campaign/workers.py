"""Who computes the cells: processes on this machine, or the workers of a Dask cluster. Jobs in, outcomes as they come.

Recordings are read once, by the caller, and shipped: workers on other machines need not see the bags, and everyone
works on the bytes that the keys were made from.
"""

from __future__ import annotations

import logging
import signal
import socket
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

from ces_identify.campaign.cell import CRASHED, Outcome, compute, failure
from ces_identify.campaign.plan import Job
from ces_identify.recordings.recording import Recording
from ces_observer import __version__
from ces_observer.errors import CesError

CONNECT_S = 10.0

Recordings = Mapping[Path, Recording]
Result = TypeVar("Result")


def on_this_machine(jobs: Sequence[Job], recordings: Recordings, processes: int) -> Generator[Outcome, None, None]:
    """Yield the outcome of each job as it ends, from so many processes with each cell's threads and no more.

    Raises CesError if a process dies.
    """
    threads = max(job.limits.threads for job in jobs)
    return in_processes(compute, ((job, *_of(job, recordings)) for job in jobs), processes, threads)


def on_cluster(jobs: Sequence[Job], recordings: Recordings, address: str) -> Generator[Outcome, None, None]:
    """Yield the outcome of each job as it ends, from the workers of the Dask scheduler at `address`.

    Each recording is sent to every worker once. Raises CesError if the cluster cannot be used, or goes away.
    """
    with cluster(address) as client:
        held = dict(zip(recordings, client.scatter(list(recordings.values()), broadcast=True, hash=False), strict=True))
        futures = {client.submit(compute, job, *_of(job, held), pure=False): job for job in jobs}
        for future in dask_distributed().as_completed(list(futures), loop=client.loop, raise_errors=False):
            reason = crash_of(future, address)
            yield future.result() if reason is None else failure(futures[future], CRASHED, reason)
            future.release()


def in_processes(
    function: Callable[..., Result], tasks: Iterable[tuple[Any, ...]], processes: int, threads: int
) -> Generator[Result, None, None]:
    """Yield what `function` makes of each task's arguments as it ends, from so many processes of so many threads.

    A task is taken from `tasks`, perhaps in another thread, when a process is free. Raises CesError if a process dies.
    """
    import joblib  # type: ignore[import-untyped]

    ordered = tuple(map(int, joblib.__version__.split(".")[:2])) < (1, 4)
    with joblib.parallel_config(backend="loky", inner_max_num_threads=threads):
        pool = joblib.Parallel(
            n_jobs=max(2, processes),  # with 1, joblib would stay in this process, where Ctrl-C would end the search
            pre_dispatch=processes,
            batch_size=1,
            return_as="generator" if ordered else "generator_unordered",
        )
        try:
            yield from pool(joblib.delayed(_in_process)(function, *task) for task in tasks)
        except BrokenProcessPool as error:
            raise broken(error) from None


def broken(error: BrokenProcessPool) -> CesError:
    """Return what to tell of processes that broke: one could not read its task, for the reason it gives, or died."""
    if error.__cause__ is not None:
        reason = str(error.__cause__).strip(' \n"').rpartition("\n")[2]
        return CesError(f"a worker process could not read its task or tell its result ({reason})")
    return CesError(
        "a worker process died, perhaps short of memory; what is finished is kept: run again with fewer --jobs"
    )


@contextmanager
def cluster(address: str) -> Iterator[Any]:
    """Open a client of the Dask scheduler at `address`, whose workers have this version of the package.

    Raises CesError if there is none.
    """
    client = _connect(dask_distributed(), address)
    try:
        _require_same_version(client, address)
        yield client
    finally:
        client.close()


def crash_of(future: Any, address: str) -> str | None:
    """Return why a task that ended has no result, None if it has one; raises CesError if the cluster went away."""
    if future.status == "finished":
        return None
    if future.status != "error":
        raise CesError(f"--dask {address}: the cluster went away; what is finished is kept: run again")
    error = future.exception()
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def _in_process(function: Callable[..., Result], *arguments: Any) -> Result:
    """Compute in a process of our own, and leave Ctrl-C, which the terminal sends to all, to the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return function(*arguments)


def _of(job: Job, held: Mapping[Path, Any]) -> tuple[list[Any], list[Any]]:
    return [held[path] for path in job.recordings], [held[path] for _, path in job.validation]


def dask_distributed() -> Any:
    """Return dask.distributed, whose log of a cluster that goes away would bury the one line that says so."""
    try:
        distributed = import_module("distributed")
    except ImportError:
        raise CesError("--dask needs dask.distributed: pip install 'ces_observer[dask]'") from None
    for handler in logging.getLogger("distributed").handlers:
        handler.setLevel(logging.CRITICAL + 1)
    return distributed


def _connect(distributed: Any, address: str) -> Any:
    """Return a client of the scheduler. That somebody listens is tried first: a client that failed is slow to end."""
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
    """Raise CesError unless every worker has this version of the package."""
    try:
        versions = client.run(_version)
    except Exception as error:  # whatever stops a worker from importing this module
        raise CesError(
            f"--dask {address}: its workers cannot run ces_identify; install ces_observer {__version__} there ({error})"
        ) from None
    for worker, version in versions.items():
        if version != __version__:
            raise CesError(f"--dask {address}: worker {worker} has ces_observer {version}; install {__version__} there")


def _version() -> str:
    return __version__
