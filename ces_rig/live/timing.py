"""Commands and time of a live rig: which current is in force, and when a sample is due.

While each sample waits for the command that answers it, a closed loop needs no clock.
"""

from __future__ import annotations

from math import inf, isfinite

QUIET = 1000  # idle periods without a command after which no answer to earlier samples can be on its way
MAX_UNASKED = 100  # commands more than samples, after which those that still come are no answers
WINDOW = 200  # freely flowing samples in which the commands are counted
MIN_ANSWERED = 0.75  # share of a window: before its first estimate, a controller commands 100 times a second unasked
MAX_LOOKS = 5  # at a commander, after which samples wait for it all the same


class Lockstep:
    """Samples flow freely until a commander answers them, and while an answer is later than `answer_s`.

    Then none is made until the answers to earlier ones have arrived (drained), or each of them would trigger samples
    forever. `unasked` counts the drains during which commands kept coming: the commander sends some on its own.
    """

    def __init__(self, answer_s: float, now_s: float) -> None:
        self._answer_s, self._sample_s = answer_s, now_s
        self._commanded = self._overdue = self._waits = self._answers = False
        self._quiet = self._looks = self.unasked = 0
        self._samples = self._commands = 0  # in the present window
        self._open = 0  # samples less commands since the first command: the answers that may be on their way
        self._heard = False  # a command since a commander is there

    def find_commander(self, is_there: bool) -> None:
        """Record whether somebody commands; samples wait once it answers them."""
        self._looks = self._looks + 1 if is_there else 0
        self._heard = self._heard and is_there
        follows = is_there and (self._commanded or self._answers or self._looks > MAX_LOOKS)
        if follows and not self._commanded:
            self._drain()
        self._commanded = follows

    def take_command(self) -> bool:
        """Return whether a command that arrived makes the next sample due."""
        self._commands += 1
        self._open = self._open - 1 if self._heard else 0
        self._heard = True
        if self._overdue or not self._waits:
            if self._overdue:
                self._drain()
            self._quiet = 0
            return False
        return self._commanded

    def is_due_idle(self, now_s: float) -> bool:
        """Return whether a sample is due at an idle period."""
        if not self._commanded:
            return True
        if self._waits:
            self._overdue = self._overdue or now_s - self._sample_s > self._answer_s
            return self._overdue
        self._quiet += 1
        are_unasked = self._open < -MAX_UNASKED
        self._waits = self._quiet >= QUIET or are_unasked
        if self._waits:
            self._open = 0
            self.unasked += are_unasked
        return self._waits

    def mark_sample(self, now_s: float) -> None:
        """Record that a sample was made."""
        self._open += 1
        self._samples += 1
        if self._samples >= WINDOW:
            self._answers = self._commands >= MIN_ANSWERED * WINDOW
            self._samples = self._commands = 0
        self._sample_s = now_s

    def _drain(self) -> None:
        self._overdue = self._waits = False
        self._quiet = 0


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


class Command:
    """Holds the last command inside `limits_A`; after `timeout_s` without a command (0: never) the safe current."""

    def __init__(self, limits_A: tuple[float, float], safe_A: float, timeout_s: float) -> None:
        self._low, self._high = limits_A
        self.safe_A, self.timeout_s = safe_A, timeout_s
        self._value, self._since = 0.0, -inf
        self.refused = 0

    def set_current(self, current_A: float, time_s: float) -> None:
        """Accept a command at a time of the rig; a command that is not finite is refused and counted."""
        if isfinite(current_A):
            self._value, self._since = current_A, time_s
        else:
            self.refused += 1

    def at(self, time_s: float) -> float:
        """Return the current [A] that the driver sets."""
        age = time_s - self._since
        is_fresh = age < inf and (self.timeout_s == 0.0 or age <= self.timeout_s)
        return min(max(self._value if is_fresh else self.safe_A, self._low), self._high)
