"""Levenberg-Marquardt on the free-run error, with a penalty on the probed gain that keeps the model stable."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ces_data.arrays import F, I
from ces_identify.numerics import kernels
from ces_identify.polynomial.problem import Problem
from ces_identify.polynomial.search_limits import SearchResult
from ces_identify.polynomial.sensitivity_kernels import normal_equations

ROOM = 0.005  # the penalty begins so far below the greatest gain allowed
PENALTY = 1e3  # of a squared excess of gain, in units of the squared error at the start
STOP_DECREASE = 2e-4  # relative decrease at which to stop
TRIES = 8  # dampings tried per step


@dataclass(frozen=True)
class FreeRunFit:
    """Coefficients (terms,), their weighted squared error (infinite if the run diverges) and Gauss-Newton matrix."""

    coefficients: F
    error: float
    matrix: F


def fit_free_run(problem: Problem, chosen: I, coefficients: F, weights: F, iterations: int) -> FreeRunFit:
    """Return the coefficients after at most `iterations` steps that lower the weighted free-run error.

    If the problem requires stable models and the first one is stable, so is every step; its probed gain may reach the
    mean of the greatest gain allowed and 1.
    """
    arrays, probes = problem.compiled.subset(chosen), problem.probes[chosen]

    def equations(c: F) -> tuple[float, F, F]:
        if kernels.probed_gain(probes, arrays.outputs, c) >= 0.5 * (1.0 + problem.max_gain):
            return np.inf, np.empty(0), np.empty(0)
        result: tuple[float, F, F] = normal_equations(
            problem.powers, problem.segments, weights, problem.measured, arrays, c, problem.force_envelope
        )
        return result

    error, matrix, gradient = equations(coefficients)
    if not np.isfinite(error):
        return FreeRunFit(coefficients, np.inf, matrix)
    hinge = _Hinge(probes, arrays.outputs, problem.max_gain - ROOM, PENALTY * error)
    value, damping = error + hinge.value(coefficients), 1e-4
    for _ in range(iterations):
        curvature, slope = hinge.derive(coefficients)
        for _ in range(TRIES):
            step = _damped_step(matrix + curvature, gradient - slope, damping)
            e, h, g = equations(coefficients + step)
            trial = e + hinge.value(coefficients + step)
            if trial < value:
                break
            damping *= 8.0
        else:
            break
        coefficients, error, matrix, gradient = coefficients + step, e, h, g
        converged = value - trial < STOP_DECREASE * value
        value, damping = trial, max(damping / 8.0, 1e-9)
        if converged:
            break
    return FreeRunFit(coefficients, error, matrix)


class _Hinge:
    """Penalty on the probed gain above a limit: strength * sum max(0, gain - limit)^2 over the points."""

    def __init__(self, probes: F, outputs: I, limit: float, strength: float) -> None:
        self.limit, self.strength = limit, strength
        lags = np.unique(outputs[outputs > 0]) if np.isfinite(limit) else np.empty(0, np.int64)
        self.groups = [np.where((outputs == lag)[:, None], probes, 0.0) for lag in lags]

    def value(self, coefficients: F) -> float:
        """Return the penalty."""
        return self.strength * float((self._excess(coefficients) ** 2).sum())

    def derive(self, coefficients: F) -> tuple[F, F]:
        """Return the penalty's Gauss-Newton matrix (terms, terms) and half its gradient (terms,)."""
        n = len(coefficients)
        excess = self._excess(coefficients)
        active = excess > 0.0
        if not active.any():
            return np.zeros((n, n)), np.zeros(n)
        slopes = np.zeros((n, int(active.sum())))
        for group in self.groups:
            slopes += group[:, active] * np.sign(coefficients @ group[:, active])
        return self.strength * slopes @ slopes.T, self.strength * slopes @ excess[active]

    def _excess(self, coefficients: F) -> F:
        if not self.groups:
            return np.zeros(1)
        gain = sum(np.abs(coefficients @ group) for group in self.groups)
        return np.maximum(gain - self.limit, 0.0)


def _damped_step(matrix: F, gradient: F, damping: float) -> F:
    """Return the Levenberg-Marquardt step, scaled by the diagonal."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix * scale[:, None] * scale + damping * np.eye(len(matrix))
    return np.asarray(scale * np.linalg.solve(scaled, scale * gradient))


ITERATIONS = 20


def refit_coefficients(problem: Problem, result: SearchResult) -> F:
    """Return coefficients fitted to the free run on all identification ticks.

    A fit that raises the selection cost is rejected; the coefficients of `result` are then returned.
    """
    fit = fit_free_run(problem, result.chosen, result.coefficients, problem.everything, ITERATIONS)
    harmless = np.isfinite(fit.error) and problem.selection_cost(result.chosen, fit.coefficients) <= result.cost
    return fit.coefficients if harmless else result.coefficients
