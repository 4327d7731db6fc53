"""Least squares of a free run, by all fits: normal equations in kernels, penalties, and Levenberg-Marquardt.

With y(k) = f(past forces, inputs; p), the sensitivities s = dy/dp of the free run obey
s(k) = df/dp + sum_j (df/dy(k - j)) s(k - j), from zero at a segment's start (Ljung, System Identification, 2nd ed.,
sec. 10.3). What a fit prefers beside the data is a penalty: a pull towards usual values, or a limit of the gains of the
past forces. A descent is an iterator: it goes on until the caller stops.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from math import inf
from typing import NamedTuple

import numpy as np
from numba import njit
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from ces_data.arrays import F, I, Mask

BLOCK = 256  # ticks of sensitivities in memory at a time
TILE = 8  # ticks added to the normal matrix in one pass over it


def one_blas_thread() -> AbstractContextManager[object]:
    """Return a context in which BLAS has one thread: matrices are small here, and idle threads spin on busy cores."""
    limited: AbstractContextManager[object] = threadpool_limits(1, "blas")
    return limited


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


class NormalEquations(NamedTuple):
    """A squared error, its Gauss-Newton matrix (n, n) and the gradient J^T (measured - simulated) (n,)."""

    error: float
    matrix: F
    gradient: F


Equations = Callable[[F, float], NormalEquations]
"""Of parameters (n,). An error above the second argument is infinite, like that of parameters that are no model; matrix
and gradient are then incomplete."""
Penalty = Callable[[F], NormalEquations]
"""The same of a penalty, which counts as a squared error of its own."""
NO_MODEL = NormalEquations(inf, np.empty((0, 0)), np.empty(0))


def check_error_first(error: Callable[[F], float], differentiate: Callable[[F], NormalEquations]) -> Equations:
    """Return equations that compute an error alone, which costs less, to see whether the rest is needed."""

    def equations(params: F, max_error: float) -> NormalEquations:
        return differentiate(params) if max_error == inf or error(params) < max_error else NO_MODEL

    return equations


def pull_towards(centre: F, weights: F) -> Penalty:
    """Return the penalty sum(weights (params - centre)^2), for arrays (n,)."""
    matrix = np.diag(weights)

    def pull(params: F) -> NormalEquations:
        away = params - centre
        return NormalEquations(float(weights @ away**2), matrix, -weights * away)

    return pull


def limit_gains(gains: Callable[[F], F], slopes: Callable[[F, Mask], F], limit: float, strength: float) -> Penalty:
    """Return the penalty strength sum(max(0, gain - limit)^2) of gains (m,) with slopes (gains in a mask, n)."""

    def excess(params: F) -> NormalEquations:
        values = gains(params)
        above = values > limit
        if not above.any():
            return NormalEquations(0.0, np.zeros((len(params), len(params))), np.zeros(len(params)))
        beyond, active = values[above] - limit, slopes(params, above)
        weighted = strength * active.T
        return NormalEquations(strength * float((beyond**2).sum()), weighted @ active, -weighted @ beyond)

    return excess


@dataclass(frozen=True)
class Damping:
    """How a descent changes its damping: divided by `faster` after a step that helps, times `slower` after another.

    It ends above `most`, and after so many `tries` without a step that helps. No parameter moves by more than
    `max_move` in a step.
    """

    first: float
    least: float
    most: float
    faster: float
    slower: float
    max_move: float = inf
    tries: float = inf


FREE = Damping(1e-2, 1e-9, 1e8, 5.0, 5.0)
CENTRED = Damping(1e-2, 1e-8, 1e7, 6.0, 4.0, max_move=0.8)


class DescentPoint(NamedTuple):
    """Parameters (n,), their normal equations with the penalties, and those of the `data` alone."""

    params: F
    total: NormalEquations
    data: NormalEquations

    @property
    def value(self) -> float:
        """The squared error with the penalties."""
        return self.total.error


def evaluate(
    equations: Equations, penalties: Sequence[Penalty], params: F, max_value: float = inf
) -> DescentPoint | None:
    """Return the point at some parameters; None unless its value is below `max_value`."""
    prices = [penalty(params) for penalty in penalties]
    data = equations(params, max_value - sum(price.error for price in prices))
    error, matrix, gradient = data
    for price in prices:
        error += price.error
    if not error < max_value:
        return None
    for price in prices:
        matrix, gradient = matrix + price.matrix, gradient + price.gradient
    return DescentPoint(params, NormalEquations(error, matrix, gradient), data)


def descend(
    equations: Equations, start: F, penalties: Sequence[Penalty] = (), damping: Damping = FREE
) -> Iterator[DescentPoint]:
    """Yield the best point so far: the start's, and after each trial step; stop when no step lowers the value.

    Nothing is yielded for a start that is no model. Damping scales with the matrix's diagonal (Marquardt 1963).
    """
    point, factor, failures = evaluate(equations, penalties, start), damping.first, 0
    if point is None:
        return
    yield point
    while factor < damping.most and failures < damping.tries:
        move = damped_step(point.total.matrix, point.total.gradient, factor)
        trial = point.params + np.clip(move, -damping.max_move, damping.max_move)
        better = evaluate(equations, penalties, trial, point.value) if np.isfinite(trial).all() else None
        if better is not None:
            point, factor, failures = better, max(factor / damping.faster, damping.least), 0
        else:
            factor, failures = factor * damping.slower, failures + 1
        yield point


def improve(
    equations: Equations, start: F, penalties: Sequence[Penalty] = (), damping: Damping = CENTRED
) -> Iterator[DescentPoint]:
    """Yield the start of a descent and each point that is better than the one before."""
    best = None
    for point in descend(equations, start, penalties, damping):
        if point is not best:
            yield point
        best = point


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
