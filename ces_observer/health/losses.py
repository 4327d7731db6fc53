"""What became of samples that are missing in the stamps: paused source, lost on the way, or lost in the node's queue.

A gap in the stamps alone does not show whether the source paused or messages were lost. Where the middleware numbers
the messages of a publisher, their numbers do. Where it does not, as with Cyclone DDS, only one cause is certain: the
node's own queue was full, if the first message after the gap had waited for as long as a full queue takes.
"""

from __future__ import annotations

FULL_SHARE = 0.9  # of the queue's length in time: the period is an average
MAX_SWITCHES = 20  # numbers that do not follow the last one; more show that several publishers share the topic


class Losses:
    """Losses on one topic whose queue holds `depth` messages.

    `lost` counts the messages that did not reach the node's callback, by their numbers; None if they have no numbers.
    `overflowed` counts those of them that its own queue dropped.
    """

    def __init__(self, depth: int) -> None:
        self.depth = depth
        self.lost: int | None = None
        self.overflowed = 0
        self._last: int | None = None
        self._switches = 0

    def take_number(self, number: int | None) -> bool:
        """Take the number of the next message; return whether this topic's numbers can be used."""
        if number is None or self._switches > MAX_SWITCHES:
            self.lost = None
            return False
        if self._last is None:
            self.lost = 0
        elif number > self._last:
            self.lost = (self.lost or 0) + number - self._last - 1
        else:  # another publisher, or one that was started again
            self._switches += 1
        self._last = number
        return True

    def take_gap(self, missing: int, waited_ns: int, period_ns: int) -> bool:
        """Count `missing` samples as overflowed if the message after them had waited for a full queue; return this."""
        if missing <= 0 or waited_ns < FULL_SHARE * self.depth * period_ns:
            return False
        self.overflowed += missing
        return True
