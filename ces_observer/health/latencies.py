"""A histogram of latencies: whole nanoseconds in, percentiles to 1.6 % and the maximum out.

The classes are log-linear as in G. Tene's HdrHistogram: each power of two has 64 equal classes.
"""

from __future__ import annotations

from bisect import bisect_left
from itertools import accumulate
from math import ceil
from typing import NamedTuple

PARTS_BITS = 6
WHOLE_BITS = PARTS_BITS + 1  # smaller numbers have a class each
MAX_NS = (1 << 37) - 1  # 137 s; the last class counts all longer ones
CLASSES = (MAX_NS.bit_length() - PARTS_BITS + 1) << PARTS_BITS


class LatencyFigures(NamedTuple):
    """One window: median, 99th percentile and maximum [ns], 0 if it was empty, and the number of latencies."""

    p50_ns: int
    p99_ns: int
    max_ns: int
    samples: int


class Latencies:
    """The latencies since the last `roll`."""

    def __init__(self) -> None:
        self._counts = [0] * CLASSES
        self._max_ns = 0

    def take(self, ns: int) -> None:
        """Count a latency; a negative one, from different clocks, counts as zero."""
        if ns > self._max_ns:  # noqa: PLR1730  # faster than max()
            self._max_ns = ns
        if not 0 <= ns <= MAX_NS:
            ns = 0 if ns < 0 else MAX_NS
        shift = ns.bit_length() - WHOLE_BITS
        if shift < 0:  # noqa: PLR1730
            shift = 0
        self._counts[(shift << PARTS_BITS) + (ns >> shift)] += 1

    def roll(self) -> LatencyFigures:
        """Return the figures of the window and begin a new one."""
        totals = list(accumulate(self._counts))
        count = totals[-1]
        figures = LatencyFigures(self._percentile(totals, 50), self._percentile(totals, 99), self._max_ns, count)
        self._counts, self._max_ns = [0] * CLASSES, 0
        return figures

    def _percentile(self, totals: list[int], percent: int) -> int:
        """Return the middle of the class that holds the smallest latency not exceeded by `percent` of all."""
        if not totals[-1]:
            return 0
        place = bisect_left(totals, ceil(totals[-1] * percent / 100))
        return min(_middle_ns(place), self._max_ns)


def _middle_ns(place: int) -> int:
    """Return the middle of a class [ns]; the first 128 hold a single whole number each."""
    shift = max(0, (place >> PARTS_BITS) - 1)
    return ((place - (shift << PARTS_BITS)) << shift) + (1 << shift >> 1)
