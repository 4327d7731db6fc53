"""The pace of a live rig: how many ticks are due, and how far it is behind."""

from __future__ import annotations


class Pace:
    """Ticks of `period_s` at `factor` times real time since `start_s` of a steady clock."""

    def __init__(self, period_s: float, start_s: float, factor: float = 1.0) -> None:
        self._period_s, self._start_s, self._factor = period_s, start_s, factor
        self._done = 0

    def count_due(self, now_s: float) -> int:
        """Return how many ticks are due at `now_s` and not yet done."""
        return int((now_s - self._start_s) * self._factor / self._period_s) - self._done

    def mark_done(self, count: int = 1) -> None:
        """Record that `count` ticks are done."""
        self._done += count

    def lag_s(self, now_s: float) -> float:
        """Return the time [s] since the next tick was due; negative if it is not due yet."""
        return now_s - self._start_s - (self._done + 1) * self._period_s / self._factor
