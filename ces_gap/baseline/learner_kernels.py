"""Compiled loops of the generic learner: low-passes and features of one tick after the other.

Most features of a tick are zero, because a spline is nonzero near its knot only. The loops therefore write terms:
the `column` and the `value` of each feature that may be nonzero. A prediction sums only these.
"""

from __future__ import annotations

from math import copysign, exp, log, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

F = NDArray[np.float64]
Index = NDArray[np.int64]

MAX_TERMS = 64  # of one tick


@njit(cache=True, nogil=True, error_model="numpy")
def low_pass(x: F, step_s: float, time_s: float) -> F:
    """Return `x` (n,) behind a first-order lag that starts in steady state."""
    out = np.empty_like(x)
    pole = exp(-step_s / time_s)
    y = x[0]
    for k in range(len(x)):
        y = x[k] + pole * (y - x[k])
        out[k] = y
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def place(value: float, knots: F) -> tuple[int, float]:
    """Return the index of the knot below a value and the weight of the one above; constant beyond the outer knots."""
    m = len(knots)
    u = min(max(value, knots[0]), knots[m - 1])
    j = 0
    for k in range(1, m - 1):  # without a branch: the processor cannot predict where a search would end
        j += 1 if u > knots[k] else 0
    return j, (u - knots[j]) / (knots[j + 1] - knots[j])


@njit(cache=True, nogil=True, error_model="numpy")
def warp(speed: float) -> float:
    """Return asinh(10·speed)."""
    size = 10.0 * abs(speed)
    return copysign(log(size + sqrt(1.0 + size * size)), speed)


@njit(cache=True, nogil=True, error_model="numpy")
def put_spline(
    column: Index, value: F, t: int, at: int, knots: int, j: int, share: float, factor: float
) -> tuple[int, int]:
    """Put the two terms of linear splines times `factor`; return the next term and column."""
    column[t], value[t] = at + j, (1.0 - share) * factor
    column[t + 1], value[t + 1] = at + j + 1, share * factor
    return t + 2, at + knots


@njit(cache=True, nogil=True, error_model="numpy")
def put(column: Index, value: F, t: int, at: int, term: float) -> tuple[int, int]:
    """Put one term; return the next term and column."""
    column[t], value[t] = at, term
    return t + 1, at + 1


@njit(cache=True, nogil=True, error_model="numpy")
def put_by_direction(
    column: Index, value: F, t: int, at: int, term: float, i: float, varies: bool, pushed: float
) -> tuple[int, int]:
    """Put a term, the same times the current if it varies, and times `pushed`; return the next term and column."""
    t, at = put(column, value, t, at, term)
    if varies:
        t, at = put(column, value, t, at, term * i)
    t, at = put(column, value, t, at, term * pushed)
    return t, at


@njit(cache=True, nogil=True, error_model="numpy")
def put_motion(
    column: Index, value: F, x: float, u: float, i: float, varies: bool, fine: F, coarse: F
) -> tuple[int, int]:
    """Put the memoryless functions of position, warped speed `u` and current; return the next term and column."""
    j, share = place(u, fine)
    t, at = put_spline(column, value, 0, 0, len(fine), j, share, 1.0)
    if varies:
        t, at = put_spline(column, value, t, at, len(fine), j, share, i)
        t, at = put_spline(column, value, t, at, len(fine), j, share, i * i)
    t, at = put(column, value, t, at, x)
    t, at = put(column, value, t, at, x * x)
    t, at = put(column, value, t, at, x * x * x)
    if varies:
        t, at = put(column, value, t, at, x * i)
    j, share = place(u, coarse)
    t, at = put_spline(column, value, t, at, len(coarse), j, share, x)
    return t, at


@njit(cache=True, nogil=True, error_model="numpy")
def put_force(column: Index, value: F, t: int, at: int, f: float, i: float, varies: bool, level: F) -> tuple[int, int]:
    """Put the memoryless functions of force and current; return the next term and column."""
    j, share = place(f, level)
    t, at = put_spline(column, value, t, at, len(level), j, share, 1.0)
    if varies:
        t, at = put_spline(column, value, t, at, len(level), j, share, i)
    t, at = put(column, value, t, at, f)
    if varies:
        t, at = put(column, value, t, at, f * i)
    return t, at


@njit(cache=True, nogil=True, error_model="numpy")
def fill_features(
    x: F, v: F, i: F, f: F, rate_Hz: float, varies: bool, by_force: bool,
    fine: F, coarse: F, level: F, turns: F, memories_s: F, valve_s: F, weights: F, out: F,
) -> None:  # fmt: skip
    """Write the features of scaled position, speed, current and force (n,) to `out` (n, q), which holds zeros.

    With `weights` (q,), write their weighted sum to `out` (n, 1) instead. `fine` and `coarse` are knots of
    asinh(10·speed), `level` those of the force.
    """
    poles, valve_poles = np.exp(-1.0 / (rate_Hz * memories_s)), np.exp(-1.0 / (rate_Hz * valve_s))
    slow_v, slow_f, slow_i = np.full(3, v[0]), np.full(3, f[0]), np.full(2, i[0])
    turn = np.zeros(len(turns))
    column, value = np.empty(MAX_TERMS, np.int64), np.empty(MAX_TERMS)
    for k in range(len(x)):
        pushed, moving = 1.0 if f[k] > 0.0 else 0.0, 1.0 if v[k] > 0.0 else 0.0
        for m in range(2):
            slow_i[m] = i[k] + valve_poles[m] * (slow_i[m] - i[k])
        for m in range(3):
            slow_v[m] = v[k] + poles[m] * (slow_v[m] - v[k])
            slow_f[m] = f[k] + poles[m] * (slow_f[m] - f[k])
        u = warp(v[k])
        t, at = put_motion(column, value, x[k], u, i[k], varies, fine, coarse)
        for r in range(len(turns)):
            if k > 0:
                turn[r] = min(max(turn[r] + x[k] - x[k - 1], -turns[r]), turns[r])
            t, at = put_by_direction(column, value, t, at, turn[r] / turns[r], i[k], varies, moving)
        if varies:
            j, share = place(u, coarse)
            for m in range(2):
                t, at = put_spline(column, value, t, at, len(coarse), j, share, i[k] - slow_i[m])
        for m in range(1 if by_force else 3):
            j, share = place(warp(slow_v[m]), fine)
            t, at = put_spline(column, value, t, at, len(fine), j, share, 1.0)
            if varies:
                t, at = put_spline(column, value, t, at, len(fine), j, share, i[k])
        if by_force:
            t, at = put_force(column, value, t, at, f[k], i[k], varies, level)
            for m in range(3):
                t, at = put_by_direction(column, value, t, at, 3.0 * (f[k] - slow_f[m]), i[k], varies, pushed)
        for r in range(t):
            if len(weights):
                out[k, 0] += weights[column[r]] * value[r]
            else:
                out[k, column[r]] = value[r]
