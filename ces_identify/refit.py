"""The last fit: a selected structure on all identification ticks, kept only if its free run does not get worse."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ces_identify import kernels
from ces_identify.problem import Problem, gram_matrix
from ces_identify.selection import RIDGE, Found

F = NDArray[np.float64]


def refitted(problem: Problem, found: Found) -> F:
    """Return coefficients fitted on all identification ticks, or the found ones if those have the better free run."""
    compiled = problem.compiled.subset(found.chosen)
    gram = gram_matrix(compiled, problem.powers, problem.measured, problem.segments, problem.fit)
    coefficients, independent = kernels.solve_normal(gram, np.arange(len(found.chosen)), RIDGE)
    stable = kernels.probed_gain(problem.probes[found.chosen], compiled.outputs, coefficients) < problem.most_gain
    better = independent and stable and _cost(problem, found, coefficients) <= _cost(problem, found, found.coefficients)
    return np.asarray(coefficients) if better else found.coefficients


def _cost(problem: Problem, found: Found, coefficients: F) -> float:
    return float(
        kernels.free_run_cost(
            problem.powers,
            problem.segments,
            problem.everything,
            problem.measured,
            *problem.compiled.subset(found.chosen).arrays,
            coefficients,
            *problem.force_envelope,
            problem.recordings,
            np.inf,
            np.empty((1 + len(coefficients), kernels.BLOCK)),
            np.empty(problem.powers.shape[1]),
        )
    )
