"""Progress of the node `identify`: messages of its process come in; a status line and values go out."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

STARTING, READING, SEARCHING, WRITING, DONE = "starting", "reading", "searching", "writing", "done"
LINES = {
    STARTING: "starting",
    READING: "reading the recordings",
    SEARCHING: "searching: no model yet",
    WRITING: "refitting, evaluating and writing the best model",
    DONE: "done",
}


class SearchState:
    """The stage, the best cost so far and the elapsed time; `error` is why the process failed, if it did."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._began_s = clock_s()
        self._limits: Mapping[str, Any] = {}
        self._best: Mapping[str, Any] = {}
        self.stage = STARTING
        self.error = ""
        self.changed = self.changed_stage = True

    def update(self, message: Mapping[str, Any]) -> None:
        """Process a message: a stage, a better model, or an error."""
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
        """Mark all changes as published."""
        self.changed = self.changed_stage = False

    def as_status(self) -> tuple[str, dict[str, str]]:
        """Return a line and values by name: stage, its time [s], share of the search, cost [%], size, starts done."""
        return self._line(), {"stage": self.stage, "elapsed [s]": f"{self._elapsed_s:.1f}", **self._search()}

    def _line(self) -> str:
        if self.stage != SEARCHING or not self._best:
            return LINES[self.stage]
        return (
            f"searching: selection cost J = {self._best['cost']:.2f} %, size {self._best['size']}, "
            f"{self._best['ended']} of {self._limits['starts']} starts done, {self._elapsed_s:.0f} s"
        )

    def _search(self) -> dict[str, str]:
        """Return the values of the search; if it ends before its time limit, the share jumps to 1."""
        if not self._limits:
            return {"share": "0.000"}
        share = min(1.0, self._elapsed_s / self._limits["seconds"]) if self.stage == SEARCHING else 1.0
        values = {"share": f"{share:.3f}"}
        if self._best:
            cost, size, ended = (self._best[key] for key in ("cost", "size", "ended"))
            values |= {"J [%]": f"{cost:.4f}", "size": str(size), "starts ended": str(ended)}
        return values

    @property
    def _elapsed_s(self) -> float:
        return self._clock_s() - self._began_s
