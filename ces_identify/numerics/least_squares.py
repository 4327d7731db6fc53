"""Least squares of a free run: its normal equations in kernels, and Levenberg-Marquardt, free and about a centre.

With y(k) = f(past forces, inputs; p), the sensitivities s = dy/dp of the free run obey
s(k) = df/dp + sum_j (df/dy(k - j)) s(k - j), from zero at a segment's start (Ljung, System Identification, 2nd ed.,
sec. 10.3). The descents are iterators: each step yields better parameters until the caller stops. About a centre, a
quadratic penalty on the distance from it applies.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import inf

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


Evaluate = Callable[[F, float], tuple[float, F, F]]


@dataclass(frozen=True)
class Damping:
    """How a descent changes its damping: divided by `faster` after a step that helps, times `slower` after another.

    No parameter moves by more than `max_move` in a step.
    """

    least: float
    most: float
    faster: float
    slower: float
    max_move: float = inf
    first: float = 1e-2


FREE = Damping(1e-9, 1e8, 5.0, 5.0)
CENTRED = Damping(1e-8, 1e7, 6.0, 4.0, max_move=0.8)


def descend(evaluate: Evaluate, start: F, damping: Damping = FREE) -> Iterator[tuple[float, F]]:
    """Yield (error, parameters) of the start and after each trial step; stop when no step lowers the error.

    `evaluate(parameters, max_error)` returns the squared error (infinite if above `max_error`), its Gauss-Newton matrix
    and the gradient J^T (measured - simulated). Damping scales with the matrix's diagonal (Marquardt 1963).
    """
    params, factor = start, damping.first
    error, matrix, gradient = evaluate(params, inf)
    if not np.isfinite(error):
        return
    yield error, params
    while factor < damping.most:
        trial = params + np.clip(damped_step(matrix, gradient, factor), -damping.max_move, damping.max_move)
        outcome = evaluate(trial, error) if np.isfinite(trial).all() else (inf, matrix, gradient)
        if outcome[0] < error:
            params, factor = trial, max(factor / damping.faster, damping.least)
            error, matrix, gradient = outcome
        else:
            factor *= damping.slower
        yield error, params


def damped_step(matrix: F, gradient: F, damping: float) -> F:
    """Return the solution of the damped normal equations; parameters without effect are unchanged."""
    diagonal = np.diag(matrix)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    scaled = matrix * scale * scale[:, None]
    scaled[np.diag_indices_from(scaled)] += damping + 1e-12
    try:
        return np.asarray(scale * np.linalg.solve(scaled, scale * gradient))
    except np.linalg.LinAlgError:
        return np.zeros_like(gradient)


@dataclass(frozen=True)
class CentredProblem:
    """What to minimise: error(theta) + sum(weights (theta - centre)^2).

    `normal_equations` returns the error, its Gauss-Newton matrix and the gradient of half of it.
    """

    error: Callable[[F], float]
    normal_equations: Callable[[F], tuple[float, F, F]]
    weights: F
    centre: F

    def penalty(self, theta: F) -> float:
        """Return the penalty."""
        return float(self.weights @ (theta - self.centre) ** 2)

    def evaluate(self, theta: F, max_error: float) -> tuple[float, F, F]:
        """Return what `descend` needs; the normal equations only of parameters below `max_error`."""
        penalty = self.penalty(theta)
        if max_error < inf and not self.error(theta) + penalty < max_error:
            return inf, np.empty(0), np.empty(0)
        error, matrix, gradient = self.normal_equations(theta)
        pull = self.weights * (theta - self.centre)
        return error + penalty, matrix + np.diag(self.weights), -gradient - pull


def descend_about_centre(problem: CentredProblem, start: F) -> Iterator[tuple[float, F]]:
    """Yield (error with penalty, parameters) after each step that lowers it; stop when none does."""
    before = start
    for value, theta in descend(problem.evaluate, start, CENTRED):
        if theta is not before:
            before = theta
            yield value, theta
