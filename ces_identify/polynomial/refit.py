"""The final fit to the free run on all identification ticks, rejected if it makes the model worse."""

from __future__ import annotations

import numpy as np

from ces_identify.numerics.arrays import F
from ces_identify.polynomial.free_run_fit import fit_free_run
from ces_identify.polynomial.problem import Problem
from ces_identify.polynomial.search_limits import SearchResult

ITERATIONS = 20


def refit_coefficients(problem: Problem, result: SearchResult) -> F:
    """Return coefficients fitted to the free run on all identification ticks.

    A fit that raises the selection cost is rejected; the coefficients of `result` are then returned.
    """
    fit = fit_free_run(problem, result.chosen, result.coefficients, problem.everything, ITERATIONS)
    harmless = np.isfinite(fit.error) and problem.selection_cost(result.chosen, fit.coefficients) <= result.cost
    return fit.coefficients if harmless else result.coefficients
