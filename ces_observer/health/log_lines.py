"""Lines of the log that neither hide an event nor flood."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from time import monotonic

QUIET_S = 1.0  # without a change, after which what has flickered is logged again


class ReasonLog:
    """The log's lines on one damper's reason: one as it changes; while it flickers none, and one when it is quiet."""

    def __init__(self) -> None:
        self._reason = ""
        self._changes = self._logged = self._withheld = 0  # the last two: at the last line
        self._changed_s = -inf
        self._is_due = False

    def find_line(self, now_s: float, reason: str, message: str, changes: int, withheld: int) -> str:
        """Return the line to log now, empty for none.

        `changes` of the reason and `withheld` samples are counted since the start.
        """
        quiet = now_s - self._changed_s >= QUIET_S
        if (reason, changes) != (self._reason, self._changes):
            self._reason, self._changes, self._changed_s, self._is_due = reason, changes, now_s, True
        if not (self._is_due and quiet):
            return ""
        count, samples = changes - self._logged, withheld - self._withheld
        self._logged, self._withheld, self._is_due = changes, withheld, False
        if count > 1:
            message += f"; {count} changes since the last line"
        return message + (f"; {samples} samples withheld" if samples > 1 else "")


class LineLimit:
    """Logs the first line of a kind; those less than a second after the one before are counted, and told by `flush`."""

    def __init__(self, log: Callable[[str], None], clock: Callable[[], float] = monotonic) -> None:
        self._log, self._clock = log, clock
        self._last, self._left, self._at_s = "", 0, -inf

    def __call__(self, text: str) -> None:
        """Log a line, or count it."""
        now = self._clock()
        if now - self._at_s < QUIET_S:
            self._left, self._last = self._left + 1, text
        else:
            self.flush()
            self._log(text)
        self._at_s = now

    def flush(self) -> None:
        """Tell the lines that were left out, once it is quiet; to be called about once a second."""
        if self._left and self._clock() - self._at_s >= QUIET_S:
            left, self._left = self._left, 0
            self._log(f"{self._last}; the last of {left} such lines")
