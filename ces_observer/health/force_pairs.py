"""Pairs each measured force with the estimate at its stamp; both arrive in separate queues and in either order."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable

HISTORY = 2048  # estimates, and measured forces that wait for one: two seconds at 1 kHz


class ForcePairs:
    """Calls `on_pair(stamp_ns, measured_N, estimated_N)` for each measured force between two estimates.

    The estimate at its stamp is interpolated linearly, unless the two are further apart than `max_gap_s`. `unpaired`
    counts the measured forces without an estimate.
    """

    def __init__(self, on_pair: Callable[[int, float, float], None], max_gap_s: float) -> None:
        self._on_pair = on_pair
        self._max_gap_ns = round(max_gap_s * 1e9)
        self._waiting: deque[tuple[int, float]] = deque()
        self._stamps: list[int] = []
        self._estimates: list[float] = []
        self.unpaired = 0

    def add_estimate(self, stamp_ns: int, force_N: float) -> None:
        """Add an estimate; one that is not later than the last shows that time was set back."""
        stamps = self._stamps
        if stamps and stamp_ns <= stamps[-1]:
            self.forget()
        elif len(stamps) >= 2 * HISTORY:
            del stamps[:HISTORY], self._estimates[:HISTORY]
        stamps.append(stamp_ns)
        self._estimates.append(force_N)
        waiting = self._waiting
        while waiting and waiting[0][0] <= stamp_ns:
            self._pair(*waiting.popleft())

    def add_measured(self, stamp_ns: int, force_N: float) -> None:
        """Add a finite measured force."""
        if self._stamps and stamp_ns <= self._stamps[-1]:
            self._pair(stamp_ns, force_N)
            return
        if len(self._waiting) >= HISTORY:
            self._waiting.popleft()
            self.unpaired += 1
        self._waiting.append((stamp_ns, force_N))

    def forget(self) -> None:
        """Forget all forces."""
        self.unpaired += len(self._waiting)
        self._waiting.clear()
        self._stamps.clear()
        self._estimates.clear()

    def _pair(self, stamp_ns: int, measured_N: float) -> None:
        """Pair a measured force that is stamped no later than the newest estimate."""
        stamps, estimates = self._stamps, self._estimates
        after = bisect_left(stamps, stamp_ns)
        if stamps[after] == stamp_ns:
            self._on_pair(stamp_ns, measured_N, estimates[after])
            return
        step_ns = stamps[after] - stamps[after - 1] if after else 0
        if not 0 < step_ns <= self._max_gap_ns:
            self.unpaired += 1
            return
        share = (stamp_ns - stamps[after - 1]) / step_ns
        before = estimates[after - 1]
        self._on_pair(stamp_ns, measured_N, before + share * (estimates[after] - before))
