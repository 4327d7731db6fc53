"""The plant's force as a static map of speed and current, from which effects know the slope of the damper.

Effects use only slopes and differences of the map, so that a plant with memory keeps its memory. The map alone, and the
same behind a spring; the compiled loops of fit and evaluation follow at the end.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import cache
from math import copysign, exp, sqrt

import numpy as np
from numba import njit
from scipy.linalg import solveh_banded

from ces_data.arrays import F, Mask
from ces_gap.grid import derivative, rms

CELLS, LEVELS = 24, 4  # of speed, of current
MAX_TICKS = 4000  # from which the map is learnt
NARROW = 0.05  # of the RMS speed: the width around standstill where the speed axis is finest
SMOOTH = 1e-3  # weight of the coefficients' second differences, per tick and cell
MAX_RECENT = 2  # maps that are kept
LEVEL = 1e-4  # weight of differences between currents, which fill empty cells
CORNER_HZ = 100.0  # [Hz] above it a simulated force is mostly noise
COMPLIANCES = (0.0, *(1.0 / np.geomspace(3e5, 3e7, 9)))  # [m/N] rigid, then from soft to stiff


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


def learn_map(speed: F, current: F, force: F, usable: Mask) -> SpeedMap:
    """Return the map of `force` [N] over speed [m/s] and current [A] on the `usable` ticks, on all if none is usable.

    Penalised least squares (Eilers and Marx, 1996); all arrays are (n,).
    """
    ticks = np.flatnonzero(usable) if usable.any() else np.arange(len(usable))
    ticks = ticks[:: max(1, len(ticks) // MAX_TICKS)]
    speed, current = speed[ticks], current[ticks]
    narrow = NARROW * rms(speed) + 1e-6
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
        self._recent: deque[tuple[tuple[F, F, F, Mask], SpeedMap]] = deque(maxlen=MAX_RECENT)

    def learn(self, speed: F, current: F, force: F, usable: Mask) -> SpeedMap:
        """Return `learn_map` of the same arguments."""
        data = (speed, current, force, usable)
        for earlier, learnt in tuple(self._recent):
            if all(a is b or np.array_equal(a, b) for a, b in zip(earlier, data, strict=True)):
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


@dataclass(frozen=True)
class SprungMap:
    """A map of speed and current behind a spring of `compliance` c [m/N]; `rest` [N] is the force at standstill."""

    map: SpeedMap
    compliance: float
    rest: float


def remove_high_frequencies(force: F, rate_Hz: float) -> F:
    """Return the force (n,) behind a low-pass without delay, which halves the power at `CORNER_HZ`."""
    each = min(CORNER_HZ, 0.25 * rate_Hz) / sqrt(2.0**0.25 - 1.0)  # four first-order lags in all
    return np.asarray(forward_backward(np.ascontiguousarray(force), exp(-2.0 * np.pi * each / rate_Hz)))


def learn_sprung_map(speed: F, current: F, force: F, usable: Mask, rate_Hz: float) -> SprungMap:
    """Return the map and spring that fit the simulated `force` [N] best on the usable ticks.

    `speed` [m/s] and `current` [A] are the inputs of the simulation; all arrays are (n,).
    """
    rate, used = derivative(remove_high_frequencies(force, rate_Hz), rate_Hz), usable | ~usable.any()
    best, least, compliant = learn_map(speed, current, force, usable), np.inf, 0.0
    for compliance in COMPLIANCES:
        through = speed - compliance * rate
        trial = learn_map(through, current, force, usable)
        residual = (force - trial.force(through, current))[used]
        if float(residual @ residual) < least:
            best, least, compliant = trial, float(residual @ residual), compliance
    return SprungMap(best, compliant, best.rest(current))


@njit(cache=True, nogil=True, error_model="numpy")
def spline_normal(u: F, s: F, y: F, cells: int, levels: int) -> tuple[F, F]:
    """Return the lower band (3·levels, m) of the normal matrix and the right side (m,) for y (n,) over splines.

    Quadratic B-splines of `u` (n,) in [0, cells] times linear ones of `s` (n,) in [0, levels - 1]; m =
    (cells + 2)·levels, the levels of a spline adjacent.
    """
    size = (cells + 2) * levels
    band, right = np.zeros((3 * levels, size)), np.zeros(size)
    place, value = np.empty(6, np.int64), np.empty(6)
    for k in range(len(u)):
        cell, t, low, w = _cell(u[k], s[k], cells, levels)
        basis = (0.5 * (1.0 - t) * (1.0 - t), 0.5 + t * (1.0 - t), 0.5 * t * t)
        for j in range(3):
            place[2 * j] = (cell + j) * levels + low
            place[2 * j + 1] = place[2 * j] + min(1, levels - 1)
            value[2 * j], value[2 * j + 1] = (1.0 - w) * basis[j], w * basis[j]
        for a in range(6):
            right[place[a]] += value[a] * y[k]
            for b in range(6):
                if place[a] >= place[b]:
                    band[place[a] - place[b], place[b]] += value[a] * value[b]
    return band, right


@njit(cache=True, nogil=True, error_model="numpy")
def _cell(u: float, s: float, cells: int, levels: int) -> tuple[int, float, int, float]:
    """Return the cell of the spline, the position in it, the level below and the weight of the one above."""
    cell = min(max(int(u), 0), cells - 1)
    low = min(max(int(s), 0), max(levels - 2, 0))
    return cell, u - cell, low, s - low if levels > 1 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _spline(u: float, s: float, table: F) -> tuple[float, float]:
    """Return the spline with coefficients `table` (cells + 2, levels), and its derivative by u."""
    width, levels = table.shape
    cell, t, low, w = _cell(u, s, width - 2, levels)
    high = min(low + 1, levels - 1)
    a = (1.0 - w) * table[cell, low] + w * table[cell, high]
    b = (1.0 - w) * table[cell + 1, low] + w * table[cell + 1, high]
    c = (1.0 - w) * table[cell + 2, low] + w * table[cell + 2, high]
    value = 0.5 * a * (1.0 - t) * (1.0 - t) + b * (0.5 + t * (1.0 - t)) + 0.5 * c * t * t
    return value, -a * (1.0 - t) + b * (1.0 - 2.0 * t) + c * t


@njit(cache=True, nogil=True, error_model="numpy")
def warp_speed(speed: float, narrow: float) -> float:
    """Return the speed [m/s] on an axis that is fine near 0: ±(√(1 + |v|/narrow) - 1)."""
    return copysign(sqrt(1.0 + abs(speed) / narrow) - 1.0, speed)


@njit(cache=True, nogil=True, error_model="numpy")
def map_force_and_slope(speed: float, s: float, narrow: float, reach: float, table: F) -> tuple[float, float]:
    """Return the force [N] and its derivative by speed [N s/m], at least 0, of a spline over warped speed and level.

    The spline spans ±`reach` of the warped speed; beyond, the force is constant.
    """
    cells = table.shape[0] - 2
    at = warp_speed(speed, narrow)
    u = (at / reach + 1.0) * (0.5 * cells)
    if u < 0.0 or u > cells:
        return _spline(min(max(u, 0.0), float(cells)), s, table)[0], 0.0
    value, slope = _spline(u, s, table)
    return value, max(slope, 0.0) * 0.25 * cells / (reach * narrow * (1.0 + abs(at)))


@njit(cache=True, nogil=True, error_model="numpy")
def map_forces_and_slopes(speed: F, s: F, narrow: float, reach: float, table: F) -> tuple[F, F]:
    """Return `map_force_and_slope` at every tick, each (n,)."""
    force, slope = np.empty_like(speed), np.empty_like(speed)
    for k in range(len(speed)):
        force[k], slope[k] = map_force_and_slope(speed[k], s[k], narrow, reach, table)
    return force, slope


@njit(cache=True, nogil=True, error_model="numpy")
def forward_backward(x: F, pole: float) -> F:
    """Return x (n,) behind two first-order lags forward and two backward: a low-pass without delay."""
    out = x.copy()
    for direction in (1, -1):
        first = 0 if direction > 0 else len(x) - 1
        a = b = out[first]
        for j in range(len(x)):
            k = first + direction * j
            a = out[k] + pole * (a - out[k])
            b = a + pole * (b - a)
            out[k] = b
    return out
