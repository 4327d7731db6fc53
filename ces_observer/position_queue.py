"""Positions held back until the current that holds for them is known: samples in as they arrive, out in that order.

Position and current come in separate queues, so that a position may be read before a current that was measured
earlier. In a burst, as when a bag is replayed, that is the rule and not the exception, and the force would depend on
which queue was read first. Waiting for a current stamped no earlier than the position makes it depend on stamps alone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

MAX_POSITIONS = 10_000  # samples: several seconds at 1 kHz; beyond it the oldest is let go


class PositionQueue:
    """A bounded queue of positions: (stamp [ns], position [m], frame) with the node's time of arrival [ns]."""

    def __init__(self, wait_s: float) -> None:
        self._queue: deque[tuple[int, float, bytes, int]] = deque()
        self.set_wait(wait_s)

    def set_wait(self, wait_s: float) -> None:
        """Set the longest wait [s] by the node's clock; 0 for none."""
        self._wait_ns = round(wait_s * 1e9)

    @property
    def is_waiting(self) -> bool:
        """True if positions are to be held back, or some still are."""
        return self._wait_ns > 0 or bool(self._queue)

    def add(self, stamp_ns: int, position_m: float, frame: bytes, now_ns: int) -> None:
        """Take a position that arrived at `now_ns`."""
        self._queue.append((stamp_ns, position_m, frame, now_ns))

    def pop_ready(self, current_ns: int | None, now_ns: int) -> Iterator[tuple[int, float, bytes]]:
        """Yield and forget the positions that need wait no longer; `current_ns` is the newest current's stamp.

        A clock that was set back ends the wait as well.
        """
        held, wait_ns = self._queue, self._wait_ns
        while held:
            stamp_ns, position_m, frame, arrived_ns = held[0]
            known = current_ns is not None and current_ns >= stamp_ns
            if not known and abs(now_ns - arrived_ns) < wait_ns and len(held) <= MAX_POSITIONS:
                return
            held.popleft()
            yield stamp_ns, position_m, frame

    def pop_all(self) -> Iterator[tuple[int, float, bytes]]:
        """Yield and forget every position."""
        while self._queue:
            yield self._queue.popleft()[:3]
