"""Compiled loops of the plant's map of speed and current (fit and evaluation), and a low-pass without delay."""

from __future__ import annotations

from math import copysign, exp, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

F = NDArray[np.float64]


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


def pole_of(corner_Hz: float, rate_Hz: float) -> float:
    """Return the pole for which `forward_backward` halves the power at `corner_Hz`."""
    each = corner_Hz / sqrt(2.0**0.25 - 1.0)  # four first-order lags in all
    return exp(-2.0 * np.pi * each / rate_Hz)
