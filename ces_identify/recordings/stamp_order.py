"""Samples that a recorder stored late, back in the order of their stamps; a clock that ran backwards is left as it is.

`ros2 bag record --compression-mode message` compresses on one thread for each core and stores a message when its thread
is done (rosbag2's SequentialCompressionWriter), so a message may follow later ones. It fills a hole that it left. Where
a clock was set back, or a bag was played again, time that was recorded already comes a second time, or much too late.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ces_identify.recordings.recording import Channel, Stamps

MAX_LATE_NS = 100_000_000  # measured: 1 to 9 ms, 2 to 8 threads on two busy cores; a thread may miss several slices
MIN_JUMP = 4  # late samples in a row, and late by as many intervals: fewer may be chance
MAX_DENSITY = 1.5  # of the samples where late ones belong, in that around them; a clock that jumps back makes it 2
AROUND_NS = 500_000_000


@dataclass(frozen=True)
class LateSamples:
    """How many samples of how many were stored after later ones, and by how much at most [ns]."""

    count: int
    total: int
    max_late_ns: int


def sort_late_samples(channel: Channel) -> tuple[Channel, LateSamples | None]:
    """Return the channel in the order of its stamps and what was late; unchanged and None if time ran backwards.

    The order of equal stamps is kept. A channel in order is returned as it is, with None.
    """
    stamps = channel.stamps_ns
    if not (stamps[1:] < stamps[:-1]).any():
        return channel, None
    latest = np.maximum.accumulate(stamps)
    late_ns = latest - stamps
    if late_ns.max() > MAX_LATE_NS:
        return channel, None
    order = np.argsort(stamps, kind="stable")
    if _comes_twice(stamps, latest, stamps[order]):
        return channel, None
    found = LateSamples(int((late_ns > 0).sum()), len(stamps), int(late_ns.max()))
    return replace(channel, stamps_ns=stamps[order], values=channel.values[order]), found


def _comes_twice(stamps: Stamps, latest: Stamps, ordered: Stamps) -> bool:
    """Return whether a run of late samples repeats time that was recorded before, as after a jump of the clock."""
    late = np.flatnonzero(stamps < latest)
    starts = np.flatnonzero(np.diff(late, prepend=-2) > 1)
    lengths = np.diff(starts, append=len(late))
    stored_before = np.minimum.accumulate(stamps)[late[starts] - 1]
    first, last = np.maximum(np.minimum.reduceat(stamps[late], starts), stored_before), latest[late[starts]]
    inside = _count(ordered, first, last)
    before, after = np.maximum(first - AROUND_NS, ordered[0]), np.minimum(last + AROUND_NS, ordered[-1])
    outside_ns = (first - before) + (after - last)
    expected = (last - first) * (_count(ordered, before, after) - inside) / np.maximum(outside_ns, 1)
    excess = inside - 1 > MAX_DENSITY * expected + 1
    return bool((excess & (lengths >= MIN_JUMP) & (expected >= MIN_JUMP - 1)).any())


def _count(ordered: Stamps, first: Stamps, last: Stamps) -> Stamps:
    """Return the number of samples from each `first` to each `last`, both included."""
    return np.searchsorted(ordered, last, side="right") - np.searchsorted(ordered, first, side="left")
