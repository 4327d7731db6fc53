"""Compiled loops of the generic learner: fading memories of a signal, plain loops over arrays."""

from __future__ import annotations

from math import exp

import numpy as np
from numba import njit
from numpy.typing import NDArray

F = NDArray[np.float64]


@njit(cache=True)
def low_passed(x: F, step_s: float, time_s: float) -> F:
    """Return `x` (n,) behind a first-order lag, started at rest."""
    out = np.empty_like(x)
    pole = exp(-step_s / time_s)
    y = x[0]
    for k in range(len(x)):
        y = x[k] + pole * (y - x[k])
        out[k] = y
    return out


@njit(cache=True)
def place(value: float, knots: F) -> tuple[int, float]:
    """Return the hat below a value, and the share of the one above; constant beyond the outer knots."""
    m = len(knots)
    u = min(max(value, knots[0]), knots[m - 1])
    j = 0
    while j < m - 2 and u > knots[j + 1]:
        j += 1
    return j, (u - knots[j]) / (knots[j + 1] - knots[j])


@njit(cache=True)
def put_hats(row: F, at: int, value: float, knots: F, first: float, second: float) -> int:
    """Write hats of `value` times `first`, then times `second` unless that is NaN; return where the row goes on."""
    j, share = place(value, knots)
    m = len(knots)
    row[at + j] += (1.0 - share) * first
    row[at + j + 1] += share * first
    if np.isnan(second):
        return at + m
    row[at + m + j] += (1.0 - share) * second
    row[at + m + j + 1] += share * second
    return at + 2 * m


@njit(cache=True)
def put_sided(row: F, at: int, value: float, i: float, varies: bool, pushed: float) -> int:
    """Write `value`, times the current if it varies, and times 1 in compression; return where the row goes on."""
    row[at] = value
    at += 1
    if varies:
        row[at] = value * i
        at += 1
    row[at] = value * pushed
    return at + 1


@njit(cache=True)
def put_motion(row: F, x: float, u: float, i: float, varies: bool, fine: F, coarse: F) -> int:
    """Write the memoryless functions of position, warped speed `u` and current; return where the row goes on."""
    at = put_hats(row, 0, u, fine, 1.0, i if varies else np.nan)
    if varies:
        at = put_hats(row, at, u, fine, i * i, np.nan)
    row[at], row[at + 1], row[at + 2] = x, x * x, x**3
    at += 3
    if varies:
        row[at] = x * i
        at += 1
    return int(put_hats(row, at, u, coarse, x, np.nan))


@njit(cache=True)
def fill_features(
    x: F, v: F, i: F, f: F, rate_Hz: float, varies: bool, by_force: bool,
    fine: F, coarse: F, level: F, turns: F, memories_s: F, valve_s: F, weights: F, out: F,
) -> None:  # fmt: skip
    """Fill `out` (n, q), zeros before, with the features of position, speed, current and force, each scaled (n,).

    With `weights` (q,), fill `out` (n, 1) with the features' weighted sum instead. Speed goes through asinh(10·speed);
    `fine`, `coarse` are knots of that, `level` those of the force.
    """
    poles, valve_poles = np.exp(-1.0 / (rate_Hz * memories_s)), np.exp(-1.0 / (rate_Hz * valve_s))
    slow_v, slow_f, slow_i = np.full(3, v[0]), np.full(3, f[0]), np.full(2, i[0])
    turn = np.zeros(len(turns))
    summed = np.zeros(len(weights))
    for k in range(len(x)):
        row = out[k]
        if len(weights):
            row = summed
            row[:] = 0.0
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
        at = put_motion(row, x[k], u, i[k], varies, fine, coarse)
        for r in range(len(turns)):
            at = put_sided(row, at, turn[r] / turns[r], i[k], varies, moving)
        if varies:
            for m in range(2):
                at = put_hats(row, at, u, coarse, i[k] - slow_i[m], np.nan)
        for m in range(1 if by_force else 3):
            at = put_hats(row, at, np.arcsinh(10.0 * slow_v[m]), fine, 1.0, i[k] if varies else np.nan)
        if by_force:
            at = put_hats(row, at, f[k], level, 1.0, i[k] if varies else np.nan)
            row[at] = f[k]
            at += 1
            if varies:
                row[at] = f[k] * i[k]
                at += 1
            for m in range(3):
                at = put_sided(row, at, 3.0 * (f[k] - slow_f[m]), i[k], varies, pushed)
        if len(weights):
            out[k, 0] = np.dot(summed, weights)
