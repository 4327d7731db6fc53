"""A queue that holds positions back until their current is known; they leave it in the order of arrival.

Position and current come in separate queues, so that a position may be read before a current that was measured
earlier. In a burst, as when a bag is replayed, this is the normal case, and the force would depend on which queue was
read first. Waiting for a current stamped no earlier than the position makes the force depend on the stamps alone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

MAX_POSITIONS = 10_000  # samples: several seconds at 1 kHz; beyond it the oldest is released


class PositionQueue:
    """A bounded queue of positions: (stamp [ns], position [m], frame) with the node's time of arrival [ns]."""

    def __init__(self, wait_s: float) -> None:
        self._queue: deque[tuple[int, float, bytes, int]] = deque()
        self.set_wait(wait_s)

    def set_wait(self, wait_s: float) -> None:
        """Set the longest wait [s] by the node's clock; 0: none."""
        self._wait_ns = round(wait_s * 1e9)

    @property
    def is_waiting(self) -> bool:
        """True if positions have to wait, or some still do."""
        return self._wait_ns > 0 or bool(self._queue)

    def add(self, stamp_ns: int, position_m: float, frame: bytes, now_ns: int) -> None:
        """Add a position that arrived at `now_ns`."""
        self._queue.append((stamp_ns, position_m, frame, now_ns))

    def pop_ready(self, current_ns: int | None, now_ns: int) -> Iterator[tuple[int, float, bytes]]:
        """Remove and yield the positions whose wait is over; `current_ns` is the newest current's stamp.

        A clock that was set back ends the wait, too. A position that arrived before simulated time began, at 0, waits
        from now.
        """
        queue, wait_ns = self._queue, self._wait_ns
        while queue:
            stamp_ns, position_m, frame, arrived_ns = queue[0]
            if not arrived_ns:
                arrived_ns = now_ns
                queue[0] = (stamp_ns, position_m, frame, now_ns)
            known = current_ns is not None and current_ns >= stamp_ns
            if not known and abs(now_ns - arrived_ns) < wait_ns and len(queue) <= MAX_POSITIONS:
                return
            queue.popleft()
            yield stamp_ns, position_m, frame

    def pop_all(self) -> Iterator[tuple[int, float, bytes]]:
        """Remove and yield all positions."""
        while self._queue:
            yield self._queue.popleft()[:3]
