"""Progress of long work: a live bar on a terminal; in a log, a line for each result or one every few seconds."""

from __future__ import annotations

import time
from types import TracebackType
from typing import Self

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from ces_cli.terminal import terminal

LOG_EVERY_S = 5.0


class LiveBar:
    """A bar labelled `label` with one task, shown while the context is open and the error stream is a terminal."""

    def __init__(self, label: str, *columns: ProgressColumn, total: float, text: str = "", done: int = 0) -> None:
        self._bar = Progress(
            TextColumn(label),
            BarColumn(bar_width=24),
            *columns,
            TextColumn("{task.description}"),
            console=terminal.err,
            transient=True,
            disable=not terminal.err.is_terminal,
        )
        self._task = self._bar.add_task(text, total=total, completed=done)
        self._began = self._logged = time.monotonic()

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, at: TracebackType | None) -> None:
        self._bar.stop()

    @property
    def elapsed_s(self) -> float:
        """Seconds since the bar was made."""
        return time.monotonic() - self._began

    def show(self, completed: float, text: str) -> None:
        """Move the bar and change the text behind it."""
        self._bar.update(self._task, completed=completed, description=text)

    def log(self, text: str) -> None:
        """Print a line if there is no terminal."""
        if self._bar.disable:
            terminal.err.print(text, highlight=False, soft_wrap=True)

    def log_seldom(self, text: str) -> None:
        """Print a line with the time if there is no terminal and the last one was some seconds ago."""
        if time.monotonic() - self._logged > LOG_EVERY_S:
            self._logged = time.monotonic()
            self.log(f"{self.elapsed_s:5.0f} s  {text}")


class JobsProgress(LiveBar):
    """Counts the finished of `total` jobs, `already` of them from an earlier run; `things` is what they are called."""

    def __init__(self, total: int, already: int, things: str) -> None:
        self.total, self.finished, self.failed = total, already, 0
        columns = (MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
        text = f"{already} from an earlier run" if already else "(Ctrl-C keeps what is finished)"
        super().__init__(things, *columns, total=total, text=text, done=already)
        if already:
            self.log(f"{already} of {total} {things} are there from an earlier run")

    def count(self, text: str, failed: bool = False) -> None:
        """Count a job that ended; `text` says how."""
        self.finished += 1
        self.failed += failed
        self.show(self.finished, text + (f"; {self.failed} failed" if self.failed else ""))
        self.log(f"{self.finished:5}/{self.total}  {text}")
