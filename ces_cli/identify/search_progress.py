"""Progress of a search: a live line on a terminal, a line every few seconds in a log."""

from __future__ import annotations

import threading
import time
from types import TracebackType

from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from ces_cli.terminal import terminal
from ces_identify.polynomial.limits import Found, Limits

LOG_EVERY_S = 5.0


class SearchProgress:
    """Shows the best cost so far; `listen` may be called from any thread."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._lock = threading.Lock()
        self._best: dict[int, Found] = {}
        self._began = self._logged = time.monotonic()
        self._bar = Progress(
            TextColumn("searching"),
            BarColumn(bar_width=24),
            TimeElapsedColumn(),
            TextColumn("{task.description}"),
            console=terminal.err,
            transient=True,
            disable=not terminal.err.is_terminal,
        )
        self._task = self._bar.add_task("no model yet (Ctrl-C keeps the best so far)", total=limits.seconds)

    def __enter__(self) -> SearchProgress:
        self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, at: TracebackType | None) -> None:
        self._bar.stop()

    def listen(self, found: Found) -> None:
        """Hear of an improvement or of the end of a start."""
        with self._lock:
            self._best[found.seed] = found
            best = min(self._best.values(), key=lambda f: f.cost)
            ended = sum(f.ended != "running" for f in self._best.values())
            text = f"selection cost J = {best.cost:.2f} % of size {len(best.chosen)}, {ended} starts ended"
            now = time.monotonic()
            self._bar.update(self._task, completed=now - self._began, description=text)
            if self._bar.disable and now - self._logged > LOG_EVERY_S:
                self._logged = now
                terminal.err.print(f"{now - self._began:5.0f} s  {text}", highlight=False)
