"""The last fit: the free-run error on all identification ticks, kept only if it does no harm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ces_identify.polynomial.free_run_fit import fit_free_run
from ces_identify.polynomial.limits import SearchResult
from ces_identify.polynomial.problem import Problem

F = NDArray[np.float64]
ITERATIONS = 20


def refit_coefficients(problem: Problem, result: SearchResult) -> F:
    """Return coefficients fitted to the free run on all identification ticks.

    The found ones are kept if the fit makes the free run on the selection ticks worse.
    """
    fit = fit_free_run(problem, result.chosen, result.coefficients, problem.everything, ITERATIONS)
    harmless = np.isfinite(fit.error) and problem.selection_cost(result.chosen, fit.coefficients) <= result.cost
    return fit.coefficients if harmless else result.coefficients
