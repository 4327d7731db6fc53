"""The plant's force as a static map of speed and current, from which effects know the slope of the damper.

Effects use only slopes and differences of the map, so that a plant with memory keeps its memory.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from ces_gap.plant_map.map_kernels import map_forces_and_slopes, spline_normal

F = NDArray[np.float64]
B = NDArray[np.bool_]

CELLS, LEVELS = 24, 4  # of speed, of current
MAX_TICKS = 4000  # from which the map is learnt
NARROW = 0.05  # of the RMS speed: the width around standstill where the speed axis is finest
SMOOTH = 1e-3  # weight of the coefficients' second differences, per tick and cell
MAX_RECENT = 2  # maps that are kept
LEVEL = 1e-4  # weight of differences between currents, which fill empty cells


@dataclass(frozen=True)
class SpeedMap:
    """Force [N] over speed and current: quadratic splines of the warped speed, linear in the current.

    `table` (cells + 2, levels) are the coefficients; the speed axis, fine within `narrow` [m/s], ends at ±`reach`.
    """

    narrow: float
    reach: float
    low_A: float
    step_A: float
    table: F

    def force_and_slope(self, speed: F, current: F) -> tuple[F, F]:
        """Return force [N] and its derivative by speed [N s/m], at least 0, at `speed` [m/s] and `current` (n,)."""
        force, slope = map_forces_and_slopes(speed, self.level(current), *self.kernel())
        return np.asarray(force), np.asarray(slope)

    def force(self, speed: F, current: F) -> F:
        """Return the force [N] (n,)."""
        return self.force_and_slope(speed, current)[0]

    def rest(self, current: F) -> float:
        """Return the force [N] at standstill: gas and offsets, which drive no flow."""
        return float(self.force(np.zeros(1), np.array([float(np.median(current))]))[0])

    def level(self, current: F) -> F:
        """Return the position (n,) of currents [A] on the current axis, 0 to levels - 1."""
        return np.asarray(np.clip((current - self.low_A) / self.step_A, 0.0, self.table.shape[1] - 1.0))

    def kernel(self) -> tuple[float, float, F]:
        """Return `narrow`, `reach` and `table` for the compiled loops."""
        return self.narrow, self.reach, self.table

    def place(self, speed: F) -> F:
        """Return the position (n,) of speeds [m/s] on the speed axis, 0 to cells."""
        warped = np.copysign(np.sqrt(1.0 + np.abs(speed) / self.narrow) - 1.0, speed)
        return np.asarray((warped / self.reach + 1.0) * (0.5 * CELLS))


def learn_map(speed: F, current: F, force: F, usable: B) -> SpeedMap:
    """Return the map of `force` [N] over speed [m/s] and current [A] on the `usable` ticks, on all if none is usable.

    Penalised least squares (Eilers and Marx, 1996); all arrays are (n,).
    """
    ticks = np.flatnonzero(usable) if usable.any() else np.arange(len(usable))
    ticks = ticks[:: max(1, len(ticks) // MAX_TICKS)]
    speed, current = speed[ticks], current[ticks]
    narrow = NARROW * float(np.sqrt(np.mean(speed**2))) + 1e-6
    reach = float(np.sqrt(1.0 + np.max(np.abs(speed)) / narrow)) - 1.0 + 1e-3
    low, span = float(current.min()), float(np.ptp(current))
    levels = LEVELS if span > 1e-3 * (1.0 + abs(low)) else 1
    blank = SpeedMap(narrow, reach, low, span / max(levels - 1, 1) or 1.0, np.zeros((CELLS + 2, levels)))
    band, right = spline_normal(blank.place(speed), blank.level(current), force[ticks], CELLS, levels)
    band += len(ticks) / CELLS * _penalty(levels)
    table = solveh_banded(band, right, lower=True, check_finite=False)
    return SpeedMap(narrow, reach, low, blank.step_A, np.asarray(table).reshape(CELLS + 2, levels))


class RecentMaps:
    """Learns maps and keeps the last few: a fit asks for the map of the same forces at each of its steps."""

    def __init__(self) -> None:
        self._recent: deque[tuple[tuple[F, F, F, B], SpeedMap]] = deque(maxlen=MAX_RECENT)

    def learn(self, speed: F, current: F, force: F, usable: B) -> SpeedMap:
        """Return `learn_map` of the same arguments."""
        data = (speed, current, force, usable)
        for known, learnt in tuple(self._recent):
            if all(a is b or np.array_equal(a, b) for a, b in zip(known, data, strict=True)):
                return learnt
        learnt = learn_map(*data)
        self._recent.appendleft((data, learnt))
        return learnt


@cache
def _penalty(levels: int) -> F:
    """Return the lower band (3·levels, m) of the penalty that keeps the coefficients smooth."""
    width = CELLS + 2
    bend, apart = np.diff(np.eye(width), 2, axis=0), np.diff(np.eye(levels), axis=0)
    whole = SMOOTH * np.kron(bend.T @ bend, np.eye(levels)) + LEVEL * np.kron(np.eye(width), apart.T @ apart)
    whole += 1e-9 * np.eye(len(whole))
    out = np.zeros((3 * levels, len(whole)))
    for k in range(3 * levels):
        out[k, : len(whole) - k] = np.diag(whole, -k)
    return out
