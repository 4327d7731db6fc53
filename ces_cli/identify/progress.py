"""How far the search of the node `identify` is: what its process tells comes in, a line and its figures go out."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

STARTING, READING, SEARCHING, WRITING, DONE = "starting", "reading", "searching", "writing", "done"
LINES = {
    STARTING: "starting",
    READING: "reading the recordings",
    SEARCHING: "searching: no model yet",
    WRITING: "fitting the best model anew, judging and writing it",
    DONE: "done",
}


class SearchState:
    """The stage, the best cost so far and the time spent. `error` is why the process gave up, if it did."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._began_s = clock_s()
        self._limits: Mapping[str, Any] = {}
        self._best: Mapping[str, Any] = {}
        self.stage = STARTING
        self.error = ""
        self.changed = self.changed_stage = True

    def update(self, message: Mapping[str, Any]) -> None:
        """Take in what the process sent: a stage, a better model, or an error."""
        self.changed = True
        if "stage" in message:
            self.stage, self.changed_stage = message["stage"], True
            self._began_s = self._clock_s()
            self._limits = message if "seconds" in message else self._limits
        elif "error" in message:
            self.error = message["error"]
        else:
            self._best = message

    def clear_changes(self) -> None:
        """Forget that anything changed."""
        self.changed = self.changed_stage = False

    def as_status(self) -> tuple[str, dict[str, str]]:
        """Return a line, and by name: stage, time in it [s], share of the search, cost [%], size, starts that ended."""
        return self._line(), {"stage": self.stage, "elapsed [s]": f"{self._elapsed_s:.1f}", **self._search()}

    def _line(self) -> str:
        if self.stage != SEARCHING or not self._best:
            return LINES[self.stage]
        return (
            f"searching: selection cost J = {self._best['cost']:.2f} % of size {self._best['size']}, "
            f"{self._best['ended']} of {self._limits['starts']} starts ended, {self._elapsed_s:.0f} s"
        )

    def _search(self) -> dict[str, str]:
        """Return the figures of the search; it may end before its time is up, and the share then is 1 at once."""
        if not self._limits:
            return {"share": "0.000"}
        share = min(1.0, self._elapsed_s / self._limits["seconds"]) if self.stage == SEARCHING else 1.0
        found = {"share": f"{share:.3f}"}
        if self._best:
            cost, size, ended = (self._best[key] for key in ("cost", "size", "ended"))
            found |= {"J [%]": f"{cost:.4f}", "size": str(size), "starts ended": str(ended)}
        return found

    @property
    def _elapsed_s(self) -> float:
        return self._clock_s() - self._began_s
