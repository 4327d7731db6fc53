"""Levenberg-Marquardt as iterators, free and within bounds: each step yields better parameters until the caller stops.

Within bounds, parameters at a bound whose gradient points outward are held (projected Newton: Bertsekas, SIAM J.
Control 20, 1982), and a quadratic penalty applies.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import inf

import numpy as np

from ces_data.arrays import F

Evaluate = Callable[[F, float], tuple[float, F, F]]

FIRST_DAMPING = 1e-2
MAX_DAMPING = 1e8
MIN_DAMPING = 1e-9


def descend(evaluate: Evaluate, start: F) -> Iterator[tuple[float, F]]:
    """Yield (error, parameters) of the start and after each trial step; stop when no step lowers the error.

    `evaluate(parameters, max_error)` returns the squared error (infinite if above `max_error`), its Gauss-Newton matrix
    and the gradient J^T (measured - simulated). Damping scales with the matrix's diagonal (Marquardt 1963).
    """
    params, damping = start, FIRST_DAMPING
    error, matrix, gradient = evaluate(params, inf)
    if not np.isfinite(error):
        return
    yield error, params
    while damping < MAX_DAMPING:
        trial = params + damped_step(matrix, gradient, damping)
        outcome = evaluate(trial, error) if np.isfinite(trial).all() else (inf, matrix, gradient)
        if outcome[0] < error:
            params = trial
            error, matrix, gradient = outcome
            damping = max(0.2 * damping, MIN_DAMPING)
        else:
            damping *= 5.0
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


BOUNDED_FIRST_DAMPING, BOUNDED_MAX_DAMPING, BOUNDED_MIN_DAMPING = 1e-2, 1e8, 1e-8
FASTER, SLOWER = 6.0, 4.0
MAX_RELEASES = 6


@dataclass(frozen=True)
class BoundedProblem:
    """What to minimise: error(theta) + sum(weights (theta - centre)^2), over low <= theta <= high.

    `normal_equations` returns the error, its Gauss-Newton matrix and the gradient of half of it; `project` moves a
    theta into the bounds.
    """

    error: Callable[[F], float]
    normal_equations: Callable[[F], tuple[float, F, F]]
    project: Callable[[F], F]
    low: F
    high: F
    weights: F
    centre: F

    def penalty(self, theta: F) -> float:
        """Return the penalty."""
        return float(self.weights @ (theta - self.centre) ** 2)


def descend_within_bounds(problem: BoundedProblem, start: F) -> Iterator[tuple[float, F]]:
    """Yield (error with penalty, parameters) after each accepted step; stop when none lowers it."""
    theta, damping = problem.project(start), BOUNDED_FIRST_DAMPING
    while damping < BOUNDED_MAX_DAMPING:
        error, matrix, gradient = problem.normal_equations(theta)
        total = error + problem.penalty(theta)
        if not np.isfinite(total):
            return
        matrix = matrix + np.diag(problem.weights)
        gradient = gradient + problem.weights * (theta - problem.centre)
        while damping < BOUNDED_MAX_DAMPING:
            trial = problem.project(theta + _step(problem, theta, matrix, gradient, damping))
            value = problem.error(trial) + problem.penalty(trial)
            if value < total:
                theta, damping = trial, max(damping / FASTER, BOUNDED_MIN_DAMPING)
                yield value, theta
                break
            damping *= SLOWER


def _step(problem: BoundedProblem, theta: F, matrix: F, gradient: F, damping: float) -> F:
    """Return the damped step of the parameters that are free to move."""
    at_low, at_high = theta <= problem.low, theta >= problem.high
    free = ~((at_low & (gradient > 0.0)) | (at_high & (gradient < 0.0)))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    step = np.zeros_like(theta)
    for _ in range(MAX_RELEASES):
        index = np.flatnonzero(free)
        if not len(index):
            return np.zeros_like(theta)
        part = matrix[np.ix_(index, index)] * scale[index] * scale[index][:, None]
        part[np.diag_indices_from(part)] += damping
        step = np.zeros_like(theta)
        try:
            step[index] = -scale[index] * np.linalg.solve(part, scale[index] * gradient[index])
        except np.linalg.LinAlgError:
            return np.zeros_like(theta)
        leaving = free & ((at_low & (step < 0.0)) | (at_high & (step > 0.0)))
        if not leaving.any():
            return step
        free &= ~leaving
    return step
