"""Progress of long work: a live bar on a terminal, in a log a line now and then; and many jobs, each result kept."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from pathlib import Path
from types import TracebackType
from typing import Self

from rich import progress as bars
from rich.markup import escape

from ces_cli.terminal import terminal
from ces_identify.jobs import DONE, ResultsFolder, Row, Shared, Task, Work, run_on_this_machine
from ces_identify.numerics.search import RUNNING, Limits, SearchResult
from ces_observer.errors import CesError

LOG_EVERY_S = 5.0


class LiveBar:
    """A progress bar with one task, shown while the context is open and the error stream is a terminal."""

    def __init__(self, label: str, *columns: bars.ProgressColumn, total: float, text: str = "", done: int = 0) -> None:
        self._bar = bars.Progress(
            bars.TextColumn(label),
            bars.BarColumn(bar_width=24),
            *columns,
            bars.TextColumn("{task.description}"),
            console=terminal.err,
            transient=True,
            disable=not terminal.err.is_terminal,
        )
        self._task = self._bar.add_task(text, total=total, completed=done)
        self._lock = threading.Lock()
        self._began = self._logged = time.monotonic()

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, at: TracebackType | None) -> None:
        self._bar.stop()

    @property
    def elapsed_s(self) -> float:
        """Seconds since the bar was created."""
        return time.monotonic() - self._began

    def show(self, completed: float, text: str) -> None:
        """Move the bar and change the text after it."""
        self._bar.update(self._task, completed=completed, description=text)

    def log(self, text: str) -> None:
        """Print a line if there is no terminal."""
        if self._bar.disable:
            terminal.err.print(text, highlight=False, soft_wrap=True)

    def log_seldom(self, text: str) -> None:
        """Print a line with the elapsed time if there is no terminal and the last line is some seconds old."""
        if time.monotonic() - self._logged > LOG_EVERY_S:
            self._logged = time.monotonic()
            self.log(f"{self.elapsed_s:5.0f} s  {text}")


class FileProgress(LiveBar):
    """Shows the share of a file that is read or written (`verb`), and how many `rows` that is, if it is set."""

    rows = 0

    def __init__(self, verb: str, path: Path) -> None:
        columns = (bars.TaskProgressColumn(), bars.TimeElapsedColumn())
        super().__init__(verb, *columns, total=1.0, text=escape(str(path)))
        self._verb, self._path = verb, path

    def listen(self, share: float) -> None:
        """Show the share (0 to 1) that is done."""
        rows = f", {self.rows} rows" if self.rows else ""
        self.show(share, escape(f"{self._path}{rows}"))
        self.log_seldom(f"{self._verb} {self._path}: {share:.0%}{rows}")


class DiagnoseProgress(LiveBar):
    """Shows the current step of a diagnosis; `listen` may be called from any thread."""

    def __init__(self, label: str = "diagnosing") -> None:
        super().__init__(label, bars.TaskProgressColumn(), bars.TimeElapsedColumn(), total=1.0)

    def listen(self, step: str, share: float) -> None:
        """Show the step that begins and the share of the work that is done."""
        with self._lock:
            self.show(share, step)
            self.log_seldom(f"{share:4.0%}  {step}")


class BestResults:
    """The best result of every one of `starts` of a search so far."""

    def __init__(self, starts: int) -> None:
        self._starts = starts
        self._by_seed: dict[int, SearchResult] = {}

    def update(self, result: SearchResult) -> None:
        """Replace the result of its start."""
        self._by_seed[result.seed] = result

    @property
    def best(self) -> SearchResult | None:
        """The result with the lowest selection cost."""
        return min(self._by_seed.values(), key=lambda result: result.cost, default=None)

    @property
    def finished(self) -> int:
        """Number of starts that have finished."""
        return sum(one.ended != RUNNING for one in self._by_seed.values())

    @property
    def share(self) -> float:
        """Share of the work that is done (0 to 1), as far as the results tell."""
        return min(1.0, sum(1.0 if r.ended != RUNNING else r.share for r in self._by_seed.values()) / self._starts)


class SearchProgress(LiveBar):
    """Shows the work and the best cost of a search so far; `listen` may be called from any thread."""

    def __init__(self, limits: Limits) -> None:
        text = "no model yet (Ctrl-C keeps the best so far)"
        super().__init__("searching", bars.TaskProgressColumn(), bars.TimeElapsedColumn(), total=1.0, text=text)
        self._results = BestResults(limits.starts)

    def listen(self, result: SearchResult) -> None:
        """Show an improvement or the end of a start."""
        with self._lock:
            self._results.update(result)
            best = self._results.best or result
            text = (
                f"selection cost J = {best.cost:.2f} %, size {len(best.chosen)}, starts done: {self._results.finished}"
            )
            self.show(self._results.share, text)
            self.log_seldom(text)


class JobsProgress(LiveBar):
    """Counts finished jobs out of `total`, `already` of them from an earlier run; `things` is their name."""

    def __init__(self, total: int, already: int, things: str) -> None:
        self.total, self.finished, self.failed, self.things = total, already, 0, things
        left = (bars.TextColumn("left"), bars.TimeRemainingColumn())
        columns = (bars.MofNCompleteColumn(), bars.TimeElapsedColumn(), *left)
        text = f"{already} from an earlier run" if already else "(Ctrl-C keeps finished results)"
        super().__init__(things, *columns, total=total, text=text, done=already)
        if already:
            terminal.err.print(f"{already} of {total} {things} are done from an earlier run", highlight=False)

    def count(self, text: str, failed: bool = False) -> None:
        """Count a finished job; `text` describes its result."""
        self.finished += 1
        self.failed += failed
        self.show(self.finished, text + (f"; {self.failed} failed" if self.failed else ""))
        self.log(f"{self.finished:5}/{self.total}  {text}")


def run_jobs(
    work: Work,
    tasks: Iterable[Task],
    shared: Shared,
    threads: int,
    processes: int | None,
    results: ResultsFolder,
    progress: JobsProgress,
    describe: Callable[[Row], str],
) -> bool:
    """Run the tasks in `processes` (default: one for each processor), store each result; False after Ctrl-C."""
    running = run_on_this_machine(work, tasks, shared, processes or os.cpu_count() or 1, threads)
    try:
        with progress, closing(running):
            for result in running:
                results.add(result)
                progress.count(describe(result.row), failed=result.row["status"] != DONE)
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
