"""Steady force over speed at constant currents, as a rig would measure it: a model's kernel in, forces out.

Each force is read at mid-stroke on a triangular stroke: from mid-stroke to one end of what was recorded (for at most
APPROACH_S) and back, at constant speed and current. What depends on the stroke alone is then that of mid-stroke.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ces_identify.numerics.arrays import F
from ces_identify.physical.models import NO_FIT, Kernel
from ces_identify.physical.valve_kernels import RunData, Score

APPROACH_S = 0.3
MIN_TICKS = 10
SPEEDS = 10
CURRENTS = 4
SLOWEST = 0.01  # relative to the fastest speed
MIN_SPEED_M_S = 1e-3  # of a direction in which nothing was recorded
RECORDED = (0.5, 99.5)  # percentiles of the speeds at about a current


def curve_speeds(slowest: float, fastest: float, count: int = SPEEDS) -> F:
    """Return 2 `count` speeds [m/s] of a curve from `slowest` < 0 to `fastest` > 0, denser towards zero."""
    shares = np.linspace(np.sqrt(SLOWEST), 1.0, count) ** 2
    return np.concatenate([min(slowest, -MIN_SPEED_M_S) * shares[::-1], max(fastest, MIN_SPEED_M_S) * shares])


def curve_currents(low: float, high: float) -> F:
    """Return the currents [A] of the curves; only one if the current was constant."""
    return np.linspace(low, high, CURRENTS) if high > low else np.array([low])


def steady_forces(kernel: Kernel, arrays: Any, position_m: tuple[float, float], speeds: F, currents: F) -> F:
    """Return the steady forces (currents, speeds) [N] of the model that `arrays` holds for `kernel`."""
    middle, half = 0.5 * sum(position_m), 0.5 * (position_m[1] - position_m[0])
    seconds = np.minimum(half / np.abs(speeds), APPROACH_S)
    there = np.maximum(np.ceil(seconds / arrays.interval_s).astype(np.int64), MIN_TICKS)
    strokes = [v * np.append(-np.ones(n), np.ones(n)) for v, n in zip(speeds, there, strict=True)]
    ends = np.cumsum(np.tile(2 * there, len(currents)))
    speed = np.tile(np.concatenate(strokes), len(currents))
    position = np.tile(np.concatenate([middle + arrays.interval_s * np.cumsum(one) for one in strokes]), len(currents))
    current = np.repeat(currents, 2 * there.sum())
    data = RunData(position, speed, current, np.column_stack([ends - np.tile(2 * there, len(currents)), ends]))
    force = np.empty(len(speed))
    nothing = Score(np.zeros(len(speed)), np.zeros(len(speed)), np.zeros(len(speed), np.int64), 1)
    kernel(arrays, data, nothing, force, NO_FIT, NO_FIT)
    return np.reshape(force[ends - 1], (len(currents), len(speeds)))  # (len(currents), len(speeds))


def recorded_speeds(speed: F, current: F, currents: F) -> list[list[float]]:
    """Return the range of the speeds (ticks,) [m/s] recorded nearest to each of the currents [A]."""
    nearest = np.abs(current[:, None] - currents).argmin(axis=1)
    return [_span(speed[nearest == n]) for n in range(len(currents))]


def _span(speed: F) -> list[float]:
    return [float(f"{end:.4g}") for end in np.percentile(speed, RECORDED)] if len(speed) else [0.0, 0.0]
