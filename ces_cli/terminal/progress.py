"""Progress of long work: a live bar on a terminal, else lines of the heartbeat; and many jobs, each result kept."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, closing
from math import inf
from pathlib import Path
from types import TracebackType
from typing import Self

from rich import progress as bars
from rich.markup import escape

from ces_cli.terminal import terminal
from ces_cli.terminal.heartbeat import heartbeat
from ces_identify.jobs import DONE, ResultsFolder, Row, Shared, Task, Work, run_on_this_machine
from ces_identify.numerics.search import RUNNING, Limits, SearchResult
from ces_observer.errors import CesError

MIN_SHARE, MIN_ELAPSED_S = 0.05, 2.0  # of the work and of its time, before the rest is estimated


class LiveBar:
    """A progress bar with one task, shown while the context is open; the heartbeat tells it without a terminal.

    It `estimates` the time that is left by the share that is done.
    """

    estimates = True

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
        self._label, self._lock, self._open = label, threading.Lock(), ExitStack()
        self._began = time.monotonic()

    def __enter__(self) -> Self:
        self._open.enter_context(heartbeat.step(self._label, live=not self._bar.disable))
        self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, at: TracebackType | None) -> None:
        self._bar.stop()
        self._open.close()

    @property
    def elapsed_s(self) -> float:
        """Seconds since the bar was created."""
        return time.monotonic() - self._began

    def show(self, completed: float, text: str) -> None:
        """Move the bar and change the text after it."""
        self._bar.update(self._task, completed=completed, description=text)
        heartbeat.change(f"{self._label}: {text}{self._estimate(completed)}")

    def _estimate(self, completed: float) -> str:
        """Return how much of the work is done, and how long the rest will take."""
        share, elapsed_s = completed / (self._bar.tasks[0].total or 1.0), self.elapsed_s
        if not self.estimates or not MIN_SHARE <= share < 1.0 or elapsed_s < MIN_ELAPSED_S:
            return ""
        return f", {share:.0%}, about {elapsed_s * (1.0 - share) / share:.0f} s left"

    def log(self, text: str) -> None:
        """Print a line if there is no terminal."""
        if self._bar.disable:
            terminal.err.print(text, highlight=False, soft_wrap=True)
            heartbeat.touch()


class FileProgress(LiveBar):
    """Shows the share of a file that is read or written (`verb`), and how many `rows` that is, if it is set."""

    rows = 0

    def __init__(self, verb: str, path: Path) -> None:
        columns = (bars.TaskProgressColumn(), bars.TimeElapsedColumn())
        super().__init__(verb, *columns, total=1.0, text=escape(str(path)))
        self._path = path

    def listen(self, share: float) -> None:
        """Show the share (0 to 1) that is done."""
        rows = f", {self.rows} rows" if self.rows else ""
        self.show(share, escape(f"{self._path}{rows}"))


class DiagnoseProgress(LiveBar):
    """Shows the current step of a diagnosis; `listen` may be called from any thread."""

    def __init__(self, label: str = "diagnosing") -> None:
        super().__init__(label, bars.TaskProgressColumn(), bars.TimeElapsedColumn(), total=1.0)

    def listen(self, step: str, share: float) -> None:
        """Show the step that begins and the share of the work that is done."""
        with self._lock:
            self.show(share, step)


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
        super().__init__("identifying", bars.TaskProgressColumn(), bars.TimeElapsedColumn(), total=1.0, text=text)
        self._results, self._step, self._limit_s = BestResults(limits.starts), "", limits.time

    def listen(self, news: SearchResult | str) -> None:
        """Show an improvement, the end of a start, or the step that begins."""
        with self._lock:
            if isinstance(news, str):
                self._step, self.estimates = f"{news}; ", False
            else:
                self._results.update(news)
                self.estimates = news.share > 0.0
            best, text = self._results.best, "no model yet"
            if best is not None:
                done = self._results.finished
                text = f"selection cost J = {best.cost:.2f} %, size {len(best.chosen)}, starts done: {done}"
            self.show(self._results.share, self._step + text)

    def _estimate(self, completed: float) -> str:
        """Return how long the rest takes: by the share that is done, or at most what the time limit leaves."""
        left_s = self._limit_s - self.elapsed_s
        return super()._estimate(completed) or (
            f"; the search ends in at most {left_s:.0f} s" if 0.0 < left_s < inf else ""
        )


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
