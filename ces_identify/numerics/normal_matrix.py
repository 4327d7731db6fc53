"""Parts that the kernels of simulation-error fitting share: sensitivities of a free run, and normal equations.

With y(k) = f(past forces, inputs; p), the sensitivities s = dy/dp of the free run obey
s(k) = df/dp + sum_j (df/dy(k - j)) s(k - j), from zero at a segment's start (Ljung, System Identification, 2nd ed.,
sec. 10.3).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ces_data.arrays import F, I

BLOCK = 256  # ticks of sensitivities in memory at a time
TILE = 8  # ticks added to the normal matrix in one pass over it


@njit(cache=True, nogil=True)
def longest_lag(lags: I) -> int:
    """Return the longest lag, at least 1."""
    depth = 1
    for lag in lags:
        depth = max(depth, lag)
    return depth


@njit(cache=True, nogil=True)
def propagate(slopes: F, k: int, lags: I, gains: F) -> None:
    """Add to row k of `slopes` (ticks, parameters) the contributions of its earlier rows through the past forces."""
    for j in range(len(lags)):
        if lags[j] > 0:
            gain, back = gains[j], k - lags[j]
            for p in range(slopes.shape[1]):
                slopes[k, p] += gain * slopes[back, p]


@njit(cache=True, nogil=True)
def accumulate(matrix: F, gradient: F, slopes: F, errors: F, weights: F) -> float:
    """Add weighted ticks to the lower triangle of the normal matrix and to the gradient; returns their squared error.

    `slopes` (ticks, parameters), `errors` (ticks,) measured minus simulated.
    """
    n = 0
    parameters = slopes.shape[1]
    rows = np.empty((TILE, parameters))
    total = 0.0
    for k in range(len(errors)):
        if weights[k] > 0.0:
            weighted = weights[k] * errors[k]
            total += weighted * errors[k]
            root = np.sqrt(weights[k])
            for p in range(parameters):
                gradient[p] += weighted * slopes[k, p]
                rows[n, p] = root * slopes[k, p]
            n += 1
        if n == TILE or (k == len(errors) - 1 and n > 0):
            rows[n:] = 0.0
            _add_tile(matrix, rows)
            n = 0
    return total


@njit(cache=True, nogil=True)
def _add_tile(matrix: F, rows: F) -> None:
    """Add the outer products of TILE rows to the lower triangle."""
    r0, r1, r2, r3, r4, r5, r6, r7 = rows[0], rows[1], rows[2], rows[3], rows[4], rows[5], rows[6], rows[7]
    for i in range(matrix.shape[0]):
        a, b, c, d, e, f, g, h = r0[i], r1[i], r2[i], r3[i], r4[i], r5[i], r6[i], r7[i]
        line = matrix[i]
        for j in range(i + 1):
            line[j] += (a * r0[j] + b * r1[j] + c * r2[j] + d * r3[j]) + (e * r4[j] + f * r5[j] + g * r6[j] + h * r7[j])


@njit(cache=True, nogil=True)
def mirror(matrix: F) -> None:
    """Copy the lower triangle to the upper one."""
    for i in range(len(matrix)):
        for j in range(i):
            matrix[j, i] = matrix[i, j]
