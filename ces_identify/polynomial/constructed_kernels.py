"""Constructed inputs over whole arrays: twins of ces_observer.structures.constructed_inputs, operation by operation.

Each takes the values of its signals (ticks,), clamped to the envelope, and `segments` (s, 2), ticks without a gap, at
whose starts it resets, and returns the constructed input (ticks,).
"""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
from numba import njit

from ces_data.arrays import F, I


@njit(cache=True, nogil=True)
def stop(values: F, segments: I, half: float) -> F:
    """Return the stop of half width `half`."""
    out = np.zeros(len(values))
    for s in range(len(segments)):
        for k in range(segments[s, 0] + 1, segments[s, 1]):
            out[k] = min(max(out[k - 1] + (values[k] - values[k - 1]), -half), half)
    return out


@njit(cache=True, nogil=True)
def play(values: F, segments: I, half: float) -> F:
    """Return the play of half width `half`."""
    out = np.zeros(len(values))
    for s in range(len(segments)):
        before = values[segments[s, 0]]
        for k in range(segments[s, 0], segments[s, 1]):
            before = min(max(before, values[k] - half), values[k] + half)
            out[k] = before
    return out


@njit(cache=True, nogil=True)
def lag(values: F, segments: I, gain: float) -> F:
    """Return the values after a first-order lag; `gain` is the weight of a new tick."""
    out = np.zeros(len(values))
    for s in range(len(segments)):
        lagged = values[segments[s, 0]]
        for k in range(segments[s, 0], segments[s, 1]):
            lagged = lagged + gain * (values[k] - lagged) if k > segments[s, 0] else values[k]
            out[k] = lagged
    return out


@njit(cache=True, nogil=True)
def frequency(position: F, speed: F, segments: I, gain: float, floor: float, low: float, high: float) -> F:
    """Return the displacement frequency [Hz] within [low, high]; `gain` is the weight of a new tick, `floor` in m."""
    out = np.zeros(len(position))
    for s in range(len(segments)):
        start = segments[s, 0]
        mean_x, mean_v, xx, vv = position[start], speed[start], 0.0, 0.0
        for k in range(start, segments[s, 1]):
            mean_x += gain * (position[k] - mean_x)
            mean_v += gain * (speed[k] - mean_v)
            x, v = position[k] - mean_x, speed[k] - mean_v
            xx += gain * (x * x - xx)
            vv += gain * (v * v - vv)
            out[k] = min(max(sqrt(vv / (xx + floor * floor)) / (2.0 * pi), low), high)
    return out
