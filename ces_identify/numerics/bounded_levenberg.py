"""Levenberg-Marquardt within bounds and with a quadratic penalty, as an iterator; the caller stops it.

Parameters at a bound whose gradient points outward are held (projected Newton: Bertsekas, SIAM J. Control 20, 1982).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ces_identify.numerics.arrays import F

FIRST_DAMPING, MAX_DAMPING, MIN_DAMPING = 1e-2, 1e8, 1e-8
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
    theta, damping = problem.project(start), FIRST_DAMPING
    while damping < MAX_DAMPING:
        error, matrix, gradient = problem.normal_equations(theta)
        total = error + problem.penalty(theta)
        if not np.isfinite(total):
            return
        matrix = matrix + np.diag(problem.weights)
        gradient = gradient + problem.weights * (theta - problem.centre)
        while damping < MAX_DAMPING:
            trial = problem.project(theta + _step(problem, theta, matrix, gradient, damping))
            value = problem.error(trial) + problem.penalty(trial)
            if value < total:
                theta, damping = trial, max(damping / FASTER, MIN_DAMPING)
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
