"""Clocks: messages without a stamp are stamped with their arrival, and a wall clock that was set is detected.

A message that waited in the node's queue, as in a stall, was sent earlier than it is read. The time of sending comes
from the publisher's clock, which may differ from the node's, so the least delay of the recent messages is taken as the
difference of the clocks with the delay of transport. A message's stamp is its time of sending plus this least delay.
"""

from __future__ import annotations

from ces_observer.limits import ClockLimits

WINDOW_NS = 20_000_000_000  # the least delay is that of one to two windows, so that it follows clocks that drift


class ArrivalClock:
    """The arrivals of one topic by the node's clock [ns], free of the node's stalls."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all delays, as after one of the clocks was set."""
        self._least_ns = self._next_ns = self._began_ns = 0
        self._empty = True

    def stamp(self, sent_ns: int, now_ns: int) -> int:
        """Return the stamp [ns] of a message sent at `sent_ns` and read at `now_ns`; 0 or less: sending unknown."""
        if sent_ns <= 0:
            return now_ns
        delay_ns = now_ns - sent_ns
        if self._empty or delay_ns - self._least_ns > ClockLimits.MAX_DELAY_NS:
            self._empty = False
            self._least_ns = self._next_ns = delay_ns
            self._began_ns = now_ns
        elif delay_ns < self._next_ns:
            self._next_ns = delay_ns
            self._least_ns = min(self._least_ns, delay_ns)
        if not 0 <= now_ns - self._began_ns < WINDOW_NS:
            self._least_ns, self._next_ns, self._began_ns = self._next_ns, delay_ns, now_ns
        return sent_ns + self._least_ns


class ClockWatch:
    """Measures how far the wall clock was set between two readings."""

    def __init__(self, wall_ns: int, steady_ns: int) -> None:
        self._ahead_ns = wall_ns - steady_ns

    def measure_jump(self, wall_ns: int, steady_ns: int) -> int:
        """Return how far [ns] the wall clock was set since the last reading, positive if forward; 0 if it was not."""
        ahead_ns = wall_ns - steady_ns
        jump_ns, self._ahead_ns = ahead_ns - self._ahead_ns, ahead_ns
        return jump_ns if abs(jump_ns) >= ClockLimits.MIN_STEP_NS else 0
