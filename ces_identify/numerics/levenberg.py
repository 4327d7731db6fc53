"""Levenberg-Marquardt as an iterator: each step yields better parameters until the caller stops."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import inf

import numpy as np

from ces_identify.numerics.arrays import F

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
