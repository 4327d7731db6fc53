"""Runs jobs in processes on this machine or on the workers of a Dask cluster; results come as they are finished.

The caller reads the objects that tasks share, such as recordings, once and sends them to the workers. These need no
access to the bags, and all use the bytes from which the keys were computed.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Generator, Hashable, Iterable, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from typing import Any, TypeVar

from ces_identify.jobs.cluster import import_dask, open_cluster
from ces_identify.jobs.job import CRASHED, Job, JobResult, describe_error, failed_job
from ces_observer.errors import CesError

TASKS_AHEAD = 2  # tasks sent ahead per thread of a cluster

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
