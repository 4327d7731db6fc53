"""Compiled loops of the generic learner: low-passes and features of one tick after the other."""

from __future__ import annotations

from math import exp

import numpy as np
from numba import njit
from numpy.typing import NDArray

F = NDArray[np.float64]


@njit(cache=True, nogil=True)
def low_pass(x: F, step_s: float, time_s: float) -> F:
    """Return `x` (n,) behind a first-order lag that starts in steady state."""
    out = np.empty_like(x)
    pole = exp(-step_s / time_s)
    y = x[0]
    for k in range(len(x)):
        y = x[k] + pole * (y - x[k])
        out[k] = y
    return out


@njit(cache=True, nogil=True)
def place(value: float, knots: F) -> tuple[int, float]:
    """Return the index of the knot below a value and the weight of the one above; constant beyond the outer knots."""
    m = len(knots)
    u = min(max(value, knots[0]), knots[m - 1])
    j = 0
    while j < m - 2 and u > knots[j + 1]:
        j += 1
    return j, (u - knots[j]) / (knots[j + 1] - knots[j])


@njit(cache=True, nogil=True)
def add(row: F, weights: F, at: int, value: float) -> None:
    """Add `value` to column `at` of the row; with weights, add the weighted value to its only column."""
    if len(weights):
        row[0] += weights[at] * value
    else:
        row[at] += value


@njit(cache=True, nogil=True)
def add_linear_splines(row: F, weights: F, at: int, value: float, knots: F, first: float, second: float) -> int:
    """Add linear splines of `value` times `first`, then times `second` unless it is NaN; return the next column."""
    j, share = place(value, knots)
    m = len(knots)
    add(row, weights, at + j, (1.0 - share) * first)
    add(row, weights, at + j + 1, share * first)
    if np.isnan(second):
        return at + m
    add(row, weights, at + m + j, (1.0 - share) * second)
    add(row, weights, at + m + j + 1, share * second)
    return at + 2 * m


@njit(cache=True, nogil=True)
def add_by_direction(row: F, weights: F, at: int, value: float, i: float, varies: bool, pushed: float) -> int:
    """Add `value`, times the current if it varies, and times `pushed`; return the next column."""
    add(row, weights, at, value)
    at += 1
    if varies:
        add(row, weights, at, value * i)
        at += 1
    add(row, weights, at, value * pushed)
    return at + 1


@njit(cache=True, nogil=True)
def add_motion_features(row: F, weights: F, x: float, u: float, i: float, varies: bool, fine: F, coarse: F) -> int:
    """Add the memoryless functions of position, warped speed `u` and current; return the next column."""
    at = add_linear_splines(row, weights, 0, u, fine, 1.0, i if varies else np.nan)
    if varies:
        at = add_linear_splines(row, weights, at, u, fine, i * i, np.nan)
    add(row, weights, at, x)
    add(row, weights, at + 1, x * x)
    add(row, weights, at + 2, x**3)
    at += 3
    if varies:
        add(row, weights, at, x * i)
        at += 1
    return int(add_linear_splines(row, weights, at, u, coarse, x, np.nan))


@njit(cache=True, nogil=True)
def add_force_features(row: F, weights: F, at: int, f: float, i: float, varies: bool, level: F) -> int:
    """Add the memoryless functions of force and current; return the next column."""
    at = add_linear_splines(row, weights, at, f, level, 1.0, i if varies else np.nan)
    add(row, weights, at, f)
    at += 1
    if varies:
        add(row, weights, at, f * i)
        at += 1
    return at


@njit(cache=True, nogil=True)
def fill_features(
    x: F, v: F, i: F, f: F, rate_Hz: float, varies: bool, by_force: bool,
    fine: F, coarse: F, level: F, turns: F, memories_s: F, valve_s: F, weights: F, out: F,
) -> None:  # fmt: skip
    """Add the features of scaled position, speed, current and force (n,) to `out` (n, q), which holds zeros.

    With `weights` (q,), add their weighted sum to `out` (n, 1) instead. `fine` and `coarse` are knots of
    asinh(10·speed), `level` those of the force.
    """
    poles, valve_poles = np.exp(-1.0 / (rate_Hz * memories_s)), np.exp(-1.0 / (rate_Hz * valve_s))
    slow_v, slow_f, slow_i = np.full(3, v[0]), np.full(3, f[0]), np.full(2, i[0])
    turn = np.zeros(len(turns))
    for k in range(len(x)):
        row = out[k]
        pushed, moving = 1.0 if f[k] > 0.0 else 0.0, 1.0 if v[k] > 0.0 else 0.0
        for r in range(len(turns)):
            if k > 0:
                turn[r] = min(max(turn[r] + x[k] - x[k - 1], -turns[r]), turns[r])
        for m in range(2):
            slow_i[m] = i[k] + valve_poles[m] * (slow_i[m] - i[k])
        for m in range(3):
            slow_v[m] = v[k] + poles[m] * (slow_v[m] - v[k])
            slow_f[m] = f[k] + poles[m] * (slow_f[m] - f[k])
        u = np.arcsinh(10.0 * v[k])
        at = add_motion_features(row, weights, x[k], u, i[k], varies, fine, coarse)
        for r in range(len(turns)):
            at = add_by_direction(row, weights, at, turn[r] / turns[r], i[k], varies, moving)
        if varies:
            for m in range(2):
                at = add_linear_splines(row, weights, at, u, coarse, i[k] - slow_i[m], np.nan)
        for m in range(1 if by_force else 3):
            at = add_linear_splines(
                row, weights, at, np.arcsinh(10.0 * slow_v[m]), fine, 1.0, i[k] if varies else np.nan
            )
        if by_force:
            at = add_force_features(row, weights, at, f[k], i[k], varies, level)
            for m in range(3):
                at = add_by_direction(row, weights, at, 3.0 * (f[k] - slow_f[m]), i[k], varies, pushed)
