"""Constructed inputs at run time, tick by tick; `ces_observer.structures.constructed_inputs` defines them.

`ces_identify.polynomial.constructed_kernels` computes the same over whole arrays, operation by operation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import pi, sqrt

TWO_PI = 2.0 * pi

# Takes a tick's values (position, speed, current, then the inputs constructed before this one); returns its value.
ConstructedRun = Callable[[Sequence[float]], float]


def make_stop_run(column: int, half: float) -> ConstructedRun:
    """Return the stop of one column of the values: the sum of its moves, clipped to ±half."""
    stop = 0.0
    last: float | None = None

    def update(values: Sequence[float]) -> float:
        nonlocal stop, last
        value = values[column]
        if last is not None:
            moved = stop + (value - last)
            stop = half if moved > half else -half if moved < -half else moved
        last = value
        return stop

    return update


def make_play_run(column: int, half: float) -> ConstructedRun:
    """Return the play of one column of the values, which follows it at a distance of at most `half`."""
    play: float | None = None

    def update(values: Sequence[float]) -> float:
        nonlocal play
        value = values[column]
        low, high = value - half, value + half
        play = value if play is None else low if play < low else high if play > high else play
        return play

    return update


def make_lag_run(column: int, gain: float) -> ConstructedRun:
    """Return one column of the values behind a first-order lag."""
    lagged: float | None = None

    def update(values: Sequence[float]) -> float:
        nonlocal lagged
        value = values[column]
        lagged = value if lagged is None else lagged + gain * (value - lagged)
        return lagged

    return update


def make_frequency_run(gain: float, floor_m: float, range_Hz: tuple[float, float]) -> ConstructedRun:
    """Return the frequency [Hz] computed from the mean squares of speed and position about their means."""
    (lowest, highest), floor = range_Hz, floor_m * floor_m
    means: tuple[float, float] | None = None
    xx = vv = 0.0

    def update(values: Sequence[float]) -> float:
        nonlocal means, xx, vv
        x, v = values[0], values[1]
        mean_x, mean_v = means or (x, v)
        mean_x += gain * (x - mean_x)
        mean_v += gain * (v - mean_v)
        means = mean_x, mean_v
        x, v = x - mean_x, v - mean_v
        xx += gain * (x * x - xx)
        vv += gain * (v * v - vv)
        frequency = sqrt(vv / (xx + floor)) / TWO_PI
        return lowest if frequency < lowest else highest if frequency > highest else frequency

    return update


def make_membership_run(column: int, at: Callable[[float], float]) -> ConstructedRun:
    """Return a membership of one column of the values, which has no past."""
    return lambda values: at(values[column])
