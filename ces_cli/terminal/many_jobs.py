"""Runs many jobs: writes each result to disk as its job ends and shows progress; Ctrl-C keeps finished results."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing

from ces_cli.terminal import terminal
from ces_cli.terminal.progress import JobsProgress
from ces_identify.jobs.job import DONE
from ces_identify.jobs.results_folder import ResultsFolder
from ces_identify.jobs.row_log import Row
from ces_identify.jobs.workers import Shared, Task, Work, run_on_cluster, run_on_this_machine
from ces_identify.progress_file import ProgressFile
from ces_observer.errors import CesError


def add_jobs(to: argparse.ArgumentParser, what: str) -> None:
    """Add the options --jobs and --dask; `what` names the runs that they apply to."""
    whole = terminal.integer_between
    to.add_argument("--jobs", type=whole(1, 256), metavar="N", help=f"{what}: processes (default: all processors)")
    to.add_argument("--dask", metavar="ADDRESS", help=f"{what}: use the workers of this Dask scheduler (host:port)")


def require_one_place(options: argparse.Namespace) -> None:
    """Raise CesError if the options name both a number of processes and a cluster."""
    if options.dask is not None and options.jobs is not None:
        raise CesError("--jobs applies to this machine only; with --dask the cluster sets the number of workers")


def run_jobs(
    work: Work,
    tasks: Iterable[Task],
    shared: Shared,
    threads: int,
    options: argparse.Namespace,
    results: ResultsFolder,
    progress: JobsProgress,
    describe: Callable[[Row], str],
    after_each: Callable[[], None] = lambda: None,
) -> bool:
    """Run the tasks on the cluster --dask or in --jobs processes (default: one per processor), and store the results.

    `after_each` is called with each stored result. Returns False if Ctrl-C came before the last.
    """
    if options.dask is not None:
        running = run_on_cluster(work, tasks, shared, options.dask)
    else:
        running = run_on_this_machine(work, tasks, shared, options.jobs or os.cpu_count() or 1, threads)
    try:
        facts = {"things": progress.things, "total": progress.total, "done": progress.finished}
        with progress, closing(running), ProgressFile("jobs", results.folder, facts) as file:
            for result in running:
                results.add(result)
                progress.count(describe(result.row), failed=result.row["status"] != DONE)
                file.write({"done": progress.finished, "failed": progress.failed})
                after_each()
    except KeyboardInterrupt:
        results.refresh()
        return False
    return True


def report_failures(rows: Sequence[Row], planned: int, finished: bool, things: str, name: Callable[[Row], str]) -> int:
    """Warn of every failed job, or of an interruption; returns the exit status. Raises CesError if all failed."""
    if not finished:
        terminal.print_warning(f"interrupted after {len(rows)} of {planned} {things}; run the same command to continue")
        return terminal.INTERRUPTED
    failed = [row for row in rows if row["status"] != DONE]
    for row in failed:
        terminal.print_warning(f"{name(row)}: {row['reason']}")
    if len(failed) == len(rows):
        raise CesError(f"all {len(rows)} {things} failed, for the reasons above")
    return 0
