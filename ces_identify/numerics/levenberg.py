"""Levenberg-Marquardt as iterators, free and about a centre: each step yields better parameters until the caller stops.

About a centre, a quadratic penalty on the distance from it applies.
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


CENTRED_FIRST_DAMPING, CENTRED_MAX_DAMPING, CENTRED_MIN_DAMPING = 1e-2, 1e7, 1e-8
FASTER, SLOWER = 6.0, 4.0
MAX_MOVE = 0.8  # of a parameter in a step


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


def descend_about_centre(problem: CentredProblem, start: F) -> Iterator[tuple[float, F]]:
    """Yield (error with penalty, parameters) after each accepted step; stop when none lowers it.

    No parameter moves by more than MAX_MOVE in a step.
    """
    theta, damping = start, CENTRED_FIRST_DAMPING
    while damping < CENTRED_MAX_DAMPING:
        error, matrix, gradient = problem.normal_equations(theta)
        total = error + problem.penalty(theta)
        if not np.isfinite(total):
            return
        matrix = matrix + np.diag(problem.weights)
        downhill = -gradient - problem.weights * (theta - problem.centre)
        while damping < CENTRED_MAX_DAMPING:
            trial = theta + np.clip(damped_step(matrix, downhill, damping), -MAX_MOVE, MAX_MOVE)
            value = problem.error(trial) + problem.penalty(trial)
            if value < total:
                theta, damping = trial, max(damping / FASTER, CENTRED_MIN_DAMPING)
                yield value, theta
                break
            damping *= SLOWER
