"""Progress of a diagnosis: a live bar on a terminal, a line every few seconds in a log."""

from __future__ import annotations

import threading
import time
from types import TracebackType

from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

from ces_cli.terminal import terminal

LOG_EVERY_S = 5.0


class DiagnoseProgress:
    """Shows what is being done; `listen` may be called from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._began = self._logged = time.monotonic()
        self._bar = Progress(
            TextColumn("diagnosing"),
            BarColumn(bar_width=24),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.description}"),
            console=terminal.err,
            transient=True,
            disable=not terminal.err.is_terminal,
        )
        self._task = self._bar.add_task("", total=1.0)

    def __enter__(self) -> DiagnoseProgress:
        self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, at: TracebackType | None) -> None:
        self._bar.stop()

    def listen(self, what: str, share: float) -> None:
        """Hear what is being done, `share` of the whole being behind."""
        with self._lock:
            self._bar.update(self._task, completed=share, description=what)
            now = time.monotonic()
            if self._bar.disable and now - self._logged > LOG_EVERY_S:
                self._logged = now
                terminal.err.print(f"{now - self._began:5.0f} s  {share:4.0%}  {what}", highlight=False)
