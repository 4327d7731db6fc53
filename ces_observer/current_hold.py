"""The current hold: the current at a position sample is the newest one stamped no later, if it is not too old.

The rule is the same offline (`ces_identify.prepare.series.hold_current`). A short history is kept because position
and current come in separate queues, so that a current may arrive before a position that was measured earlier. A speed
or acceleration that a model needs is held in the same way.

In a burst, as when a bag is replayed, a position is often read before its current, and the force would depend on which
queue was read first. A `PositionQueue` holds positions back until a current stamped no earlier is known, which makes
the force depend on the stamps alone.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterator
from math import isfinite, nan

from ces_observer.limits import ClockLimits

HISTORY = 8192  # currents kept: more than a subscription's queue holds, so that a burst loses none


class CurrentHold:
    """Newest current [A] at or before a stamp [ns], NaN if there is none or it is older than `max_age_s`."""

    def __init__(self, max_age_s: float) -> None:
        self._max_age_ns = round(max_age_s * 1e9)
        self._stamps: list[int] = []
        self._values: list[float] = []

    def with_max_age(self, max_age_s: float) -> CurrentHold:
        """Return a view of the same currents, present and future, with another age limit."""
        view = CurrentHold(max_age_s)
        view._stamps, view._values = self._stamps, self._values
        return view

    @property
    def newest_ns(self) -> int | None:
        """The latest stamp of a known current [ns]."""
        return self._stamps[-1] if self._stamps else None

    def reset(self) -> None:
        """Forget every current."""
        self._stamps.clear()
        self._values.clear()

    def add(self, stamp_ns: int, current_A: float) -> None:
        """Add a current; one that is not finite is ignored."""
        if not isfinite(current_A):
            return
        stamps = self._stamps
        if stamps and stamp_ns < stamps[-1] - ClockLimits.JUMP_NS:
            self.reset()
        if stamps and stamp_ns < stamps[-1]:
            place = bisect_right(stamps, stamp_ns)
            stamps.insert(place, stamp_ns)
            self._values.insert(place, current_A)
        else:
            stamps.append(stamp_ns)
            self._values.append(current_A)
        if len(stamps) > 2 * HISTORY:
            del stamps[:HISTORY], self._values[:HISTORY]

    def at(self, stamp_ns: int) -> float:
        """Return the current [A] that holds at `stamp_ns`, or NaN."""
        stamps, newest = self._stamps, -1
        if not stamps or stamp_ns < stamps[-1]:
            newest = bisect_right(stamps, stamp_ns) - 1
            if newest < 0:
                return nan
        return self._values[newest] if stamp_ns - stamps[newest] <= self._max_age_ns else nan

    def explain(self, stamp_ns: int, name: str = "current") -> str:
        """Return why `at` returns NaN at `stamp_ns` for the signal `name`; empty if none was received at all."""
        if not self._stamps:
            return ""
        newest = bisect_right(self._stamps, stamp_ns) - 1
        limit = self._max_age_ns * 1e-9
        if newest < 0:
            ahead = (self._stamps[0] - stamp_ns) * 1e-9
            question = ": are both on one clock?" if ahead > limit else ""
            return f"the position was measured {ahead:.3g} s before the first known {name}" + question
        age = (stamp_ns - self._stamps[newest]) * 1e-9
        return f"the newest {name} is {age:.3g} s older than the position; the model allows {limit:g} s"


class ConstantCurrent(CurrentHold):
    """A known current that is not measured, such as the 0 A of a passive damper; it does not age."""

    def __init__(self, current_A: float) -> None:
        super().__init__(0.0)
        self._value = current_A

    def with_max_age(self, max_age_s: float) -> CurrentHold:
        """Return itself."""
        return self

    def add(self, stamp_ns: int, current_A: float) -> None:
        """Ignore a received current."""

    def at(self, stamp_ns: int) -> float:
        """Return the current [A]."""
        return self._value


MAX_POSITIONS = 10_000  # samples: several seconds at 1 kHz; beyond it the oldest is released


class PositionQueue:
    """A bounded first-in first-out queue of positions: (stamp [ns], position [m], frame), with their arrival [ns]."""

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
