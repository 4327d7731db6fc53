"""Runs many jobs from a program: their results go to disk as they end, progress to the terminal; Ctrl-C keeps them."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterable
from contextlib import closing

from ces_cli.terminal.progress import JobsProgress
from ces_identify.jobs.job import DONE, JobResult
from ces_identify.jobs.results_folder import ResultsFolder
from ces_identify.jobs.row_log import Row
from ces_identify.jobs.workers import Shared, Task, Work, run_on_cluster, run_on_this_machine
from ces_observer.errors import CesError


def require_one_place(jobs: int | None, dask: str | None) -> None:
    """Raise CesError if both a number of processes and a cluster are given."""
    if dask is not None and jobs is not None:
        raise CesError("--jobs is about this machine; with --dask the cluster's workers are what there is")


def start_jobs(
    work: Work, tasks: Iterable[Task], shared: Shared, jobs: int | None, dask: str | None, threads: int
) -> Generator[JobResult, None, None]:
    """Yield results from the Dask scheduler at `dask`, or from `jobs` processes (default: one a processor)."""
    if dask is not None:
        return run_on_cluster(work, tasks, shared, dask)
    return run_on_this_machine(work, tasks, shared, jobs or os.cpu_count() or 1, threads)


def keep_results(
    started: Generator[JobResult, None, None],
    results: ResultsFolder,
    progress: JobsProgress,
    describe: Callable[[Row], str],
) -> bool:
    """Write each result as its job ends; returns False if Ctrl-C came before the last."""
    try:
        with progress, closing(started):
            for result in started:
                results.add(result)
                progress.count(describe(result.row), failed=result.row["status"] != DONE)
    except KeyboardInterrupt:
        results.refresh()
        return False
    return True
