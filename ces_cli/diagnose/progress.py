"""Progress of a diagnosis: a live bar on a terminal, a line every few seconds in a log."""

from __future__ import annotations

import threading

from rich.progress import TaskProgressColumn, TimeElapsedColumn

from ces_cli.terminal.progress import LiveBar


class DiagnoseProgress(LiveBar):
    """Shows what is being done; `listen` may be called from any thread."""

    def __init__(self) -> None:
        super().__init__("diagnosing", TaskProgressColumn(), TimeElapsedColumn(), total=1.0)
        self._lock = threading.Lock()

    def listen(self, what: str, share: float) -> None:
        """Hear what is being done, `share` of the whole being behind."""
        with self._lock:
            self.show(share, what)
            self.log_seldom(f"{share:4.0%}  {what}")
