"""Progress of a search: a live line on a terminal, a line every few seconds in a log."""

from __future__ import annotations

import threading

from rich.progress import TimeElapsedColumn

from ces_cli.terminal.progress import LiveBar
from ces_identify.polynomial.limits import Limits, SearchResult


class SearchProgress(LiveBar):
    """Shows the best cost so far; `listen` may be called from any thread."""

    def __init__(self, limits: Limits) -> None:
        text = "no model yet (Ctrl-C keeps the best so far)"
        super().__init__("searching", TimeElapsedColumn(), total=limits.seconds, text=text)
        self._lock = threading.Lock()
        self._best: dict[int, SearchResult] = {}

    def listen(self, result: SearchResult) -> None:
        """Hear of an improvement or of the end of a start."""
        with self._lock:
            self._best[result.seed] = result
            best = min(self._best.values(), key=lambda f: f.cost)
            ended = sum(f.ended != "running" for f in self._best.values())
            text = f"selection cost J = {best.cost:.2f} % of size {len(best.chosen)}, {ended} starts ended"
            self.show(self.elapsed_s, text)
            self.log_seldom(text)
