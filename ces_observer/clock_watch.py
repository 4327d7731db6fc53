"""Notices when the computer's wall clock is set: it is looked at now and then beside the clock that cannot be set."""

from __future__ import annotations

MIN_JUMP_NS = 100_000_000  # far above what a clock that is merely steered gains between two looks


class ClockWatch:
    """How far the wall clock was set between two looks."""

    def __init__(self, wall_ns: int, steady_ns: int) -> None:
        self._ahead_ns = wall_ns - steady_ns

    def measure_jump(self, wall_ns: int, steady_ns: int) -> int:
        """Return by how much [ns] the wall clock was set since the last look, positive if forward; 0 if it was not."""
        ahead_ns = wall_ns - steady_ns
        jump_ns, self._ahead_ns = ahead_ns - self._ahead_ns, ahead_ns
        return jump_ns if abs(jump_ns) >= MIN_JUMP_NS else 0
