"""When a sample is due while each one waits for the command that answers it: a closed loop then needs no clock."""

from __future__ import annotations

QUIET = 1000  # idle periods without a command after which no answer to earlier samples can be on its way
MAX_DRAIN = 3000  # idle periods after which commands that still come are taken for no answers


class Lockstep:
    """Samples flow freely until a commander appears, and while an answer is later than `answer_s`.

    Then none is made until the answers to earlier ones have arrived (drained), or each of them would trigger samples
    forever. `unasked` counts the drains during which commands kept coming: the commander sends some on its own.
    """

    def __init__(self, answer_s: float, now_s: float) -> None:
        self._answer_s, self._sample_s = answer_s, now_s
        self._commanded = self._overdue = self._waits = False
        self._quiet = self._drained = self.unasked = 0

    def find_commander(self, is_there: bool) -> None:
        """Record whether somebody commands."""
        if is_there and not self._commanded:
            self._drain()
        self._commanded = is_there

    def take_command(self) -> bool:
        """Return whether a command that arrived makes the next sample due."""
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
        self._drained += 1
        self._waits = self._quiet >= QUIET or self._drained >= MAX_DRAIN
        self.unasked += self._waits and self._quiet < QUIET
        return self._waits

    def mark_sample(self, now_s: float) -> None:
        """Record that a sample was made."""
        self._sample_s = now_s

    def _drain(self) -> None:
        self._overdue = self._waits = False
        self._quiet = self._drained = 0
