"""The tick's tracker over whole arrays: stamps and positions in, uniform ticks out."""

from __future__ import annotations

from math import floor, log, nan
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ces_data.arrays import F, I
from ces_identify.numerics.core import compiled, core_kernel, pointer
from ces_observer.model import Sampling
from ces_observer.sampling_layout import layout_of
from ces_observer.tick import tracker
from ces_observer.tick.bank import BANK_POSITION, BANK_SPEED, DELAY, TOTAL
from ces_observer.tick.tracker import (
    AHEAD, INNOVATION, LAST_TICK, LATE_AT, LATE_KNOWN, MAX_GAP_NS, OK, OLD_POSITION, OLD_SPEED, ORIGIN, PATIENCE, TICKS,
    UNSETTLED,
)  # fmt: skip

tracker_advance = compiled(tracker.tracker_advance)


class Tracked(NamedTuple):
    """The result of `track` for n samples: m ticks (m, 2) of position [m] and speed [m/s] with their stamps (m,) [ns].

    For each sample: the number of ticks so far, its status (a code of `ces_observer.tick.tracker`), and its time after
    the last tick [ticks]. `late` (m, 2) are the ticks as they are known after the sampling's delay, NaN where they
    never are; without a delay, the ticks. `innovations` (n,) [m] are NaN where there is none. `likelihood` is the mean
    log likelihood of the measured ticks.
    """

    ticks: F
    stamps_ns: I
    total: I
    status: NDArray[np.int8]
    ahead: F
    late: F
    innovations: F
    likelihood: float


def track(stamps_ns: I, positions: F, sampling: Sampling, motion: F | None = None) -> Tracked:
    """Return the ticks of n samples; `motion` (n,) is the signal that the sampling names."""
    arrays = layout_of(sampling).arrays()
    p, n, s, k = (np.array(arrays.p), np.array(arrays.n, np.int64), np.array(arrays.s), np.array(arrays.k, np.int64))
    motion = np.zeros(len(stamps_ns)) if motion is None else motion
    return Tracked(*_track(p, n, s, k, stamps_ns, positions, motion, sampling.rate_Hz))


@core_kernel
def _track(numbers: F, counts: I, states: F, flags: I, stamps: I, positions: F, motion: F, rate: float) -> Any:
    """Do the work of `track`, with new arrays of the tick."""
    p, n, s, k = pointer(numbers), pointer(counts), pointer(states), pointer(flags)
    count, delay = len(stamps), n[DELAY]
    room = count + 2
    for i in range(1, count):
        room += int(min(abs(stamps[i] - stamps[i - 1]), (PATIENCE + 2) * n[MAX_GAP_NS]) * rate * 1e-9) + 2
    ticks, times = np.empty((room, 2)), np.empty(room, np.int64)  # unused rows cost nothing
    late = np.empty((room, 2)) if delay > 0 else ticks
    total, status = np.zeros(count, np.int64), np.zeros(count, np.int8)
    ahead, innovations = np.zeros(count), np.empty(count)
    m = measured = 0
    likelihood = 0.0
    for i in range(count):
        s[INNOVATION] = nan
        status[i] = tracker_advance(p, n, s, k, stamps[i], positions[i], motion[i])
        innovations[i] = s[INNOVATION]
        fresh = k[TICKS]
        if status[i] == OK or status[i] == UNSETTLED:
            ahead[i] = s[AHEAD]
            if fresh > 0:
                likelihood += log(s[TOTAL])
                measured += 1
        for j in range(fresh):
            share = (j + 1) / fresh
            ticks[m, 0] = s[OLD_POSITION] + share * (s[BANK_POSITION] - s[OLD_POSITION])
            ticks[m, 1] = s[OLD_SPEED] + share * (s[BANK_SPEED] - s[OLD_SPEED])
            times[m] = k[ORIGIN] + np.int64(floor((k[LAST_TICK] - fresh + 1 + j) * (1e9 / rate) + 0.5))
            if delay > 0:
                late[m, 0] = late[m, 1] = nan
                if k[n[LATE_KNOWN] + j] != 0:
                    late[m - delay, 0], late[m - delay, 1] = s[n[LATE_AT] + 2 * j], s[n[LATE_AT] + 2 * j + 1]
            m += 1
        if fresh > 0:
            ticks[m - 1, 0], ticks[m - 1, 1] = s[BANK_POSITION], s[BANK_SPEED]
        total[i] = m
    return ticks[:m], times[:m], total, status, ahead, late[:m], innovations, likelihood / max(measured, 1)
