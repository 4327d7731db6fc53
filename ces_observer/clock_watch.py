"""Detects that the computer's wall clock was set, by comparing it now and then with the steady clock."""

from __future__ import annotations

MIN_JUMP_NS = 100_000_000  # far above what a slewed clock gains between two readings


class ClockWatch:
    """Measures how far the wall clock was set between two readings."""

    def __init__(self, wall_ns: int, steady_ns: int) -> None:
        self._ahead_ns = wall_ns - steady_ns

    def measure_jump(self, wall_ns: int, steady_ns: int) -> int:
        """Return how far [ns] the wall clock was set since the last reading, positive if forward; 0 if it was not."""
        ahead_ns = wall_ns - steady_ns
        jump_ns, self._ahead_ns = ahead_ns - self._ahead_ns, ahead_ns
        return jump_ns if abs(jump_ns) >= MIN_JUMP_NS else 0
