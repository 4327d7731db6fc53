"""The plant's force as a static map of speed and current: what effects need to know how steep the damper is.

Only slopes and differences of it are used, never the map itself: a plant with memory keeps its memory.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from ces_gap.plant_map.map_kernels import map_forces_and_slopes, spline_normal

F = NDArray[np.float64]
B = NDArray[np.bool_]

CELLS, LEVELS = 24, 4  # of speed and of current
MAX_TICKS = 4000  # ticks that the map is learnt from
NARROW = 0.05  # of the RMS speed: where the speed's axis is finest
SMOOTH = 1e-3  # weight of the coefficients' second differences, per tick and cell
LEVEL = 1e-4  # weight of differences between currents, which fill cells nobody visited


@dataclass(frozen=True)
class SpeedMap:
    """Force [N] over speed and current: quadratic splines over the warped speed, straight in the current.

    `table` (cells + 2, levels) are the coefficients; the speed's axis, fine within
    `narrow` [m/s] of standstill, ends at ±`reach`.
    """

    narrow: float
    reach: float
    low_A: float
    step_A: float
    table: F

    def force_and_slope(self, speed: F, current: F) -> tuple[F, F]:
        """Return force [N] and its derivative by speed [N s/m], never negative, at `speed` [m/s] and `current` (n,)."""
        found = map_forces_and_slopes(speed, self.level(current), self.narrow, self.reach, self.table)
        return np.asarray(found[0]), np.asarray(found[1])

    def force(self, speed: F, current: F) -> F:
        """Return the force [N] (n,)."""
        return self.force_and_slope(speed, current)[0]

    def rest(self, current: F) -> float:
        """Return the force [N] at standstill: gas and offsets, which drive no flow."""
        middle = np.array([float(np.median(current))])
        return float(self.force(np.zeros(1), middle)[0])

    def level(self, current: F) -> F:
        """Return where on the current's axis (n,) currents [A] are, from 0 to levels - 1."""
        return np.asarray(np.clip((current - self.low_A) / self.step_A, 0.0, self.table.shape[1] - 1.0))

    def kernel(self) -> tuple[float, float, F]:
        """Return what compiled loops need besides the level: `narrow`, `reach`, `table`."""
        return self.narrow, self.reach, self.table

    def place(self, speed: F) -> F:
        """Return where on the speed's axis (n,) speeds [m/s] are, from 0 to cells."""
        warped = np.copysign(np.sqrt(1.0 + np.abs(speed) / self.narrow) - 1.0, speed)
        return np.asarray((warped / self.reach + 1.0) * (0.5 * CELLS))


def learn_map(speed: F, current: F, force: F, usable: B) -> SpeedMap:
    """Return the map of `force` [N] over speed [m/s] and current [A], each (n,), by penalised least squares.

    It is learnt from the `usable` ticks (n,), from all if there is none (Eilers and Marx 1996).
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


def _penalty(levels: int) -> F:
    """Return the lower band (3·levels, m) of the matrix that holds the coefficients smooth."""
    width = CELLS + 2
    bend, apart = np.diff(np.eye(width), 2, axis=0), np.diff(np.eye(levels), axis=0)
    whole = SMOOTH * np.kron(bend.T @ bend, np.eye(levels)) + LEVEL * np.kron(np.eye(width), apart.T @ apart)
    whole += 1e-9 * np.eye(len(whole))
    out = np.zeros((3 * levels, len(whole)))
    for k in range(3 * levels):
        out[k, : len(whole) - k] = np.diag(whole, -k)
    return out
