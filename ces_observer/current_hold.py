"""The current hold: the current at a position sample is the newest one stamped no later, if it is not too old.

The rule is the same offline (`ces_identify.prepare.series.hold_current`). A short history is kept because position
and current come in separate queues, so that a current may arrive before a position that was measured earlier. A speed
or acceleration that a model needs is held in the same way.
"""

from __future__ import annotations

from bisect import bisect_right
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

    def shows_jump(self, stamp_ns: int) -> bool:
        """Return whether a current stamped so shows that the clock was set back."""
        return bool(self._stamps) and stamp_ns < self._stamps[-1] - ClockLimits.JUMP_NS

    def reset(self) -> None:
        """Forget every current."""
        self._stamps.clear()
        self._values.clear()

    def add(self, stamp_ns: int, current_A: float) -> None:
        """Add a current; one that is not finite is ignored."""
        if not isfinite(current_A):
            return
        stamps = self._stamps
        if self.shows_jump(stamp_ns):
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
