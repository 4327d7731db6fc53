"""The refit of one group of parameters, the others held, with its standard errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from ces_gap.trace import F
from ces_gap.witness.target import RefitTarget
from ces_identify.numerics.bounded_levenberg import BoundedProblem, descend_within_bounds

MAX_STEPS = 4
PENALTY = 0.003  # [J %] of a change of one parameter by its scale: holds what the recordings do not determine
MAX_Z = 37.0  # larger ones cannot be told from each other in double precision

I = NDArray[np.int64]


@dataclass(frozen=True)
class Movement:
    """How far the parameters at the places `free` move by a refit: `change` (n,) and its covariance (n, n)."""

    free: I
    change: F
    covariance: F


@dataclass(frozen=True)
class Linearisation:
    """Gauss-Newton matrix (n, n) and gradients (blocks, n) of half the squared error by all parameters."""

    matrix: F
    gradients: F


def linearise(target: RefitTarget, theta: F) -> Linearisation:
    """Return the linearisation at `theta`."""
    return Linearisation(*target.models.block_gradients(theta, target.weights, target.blocks))


def places_of(target: RefitTarget, parts: Sequence[str]) -> I:
    """Return the places in theta of the named parts of the layout that the model has."""
    sizes = [len(g.start) for g in target.models.layout.groups]
    firsts = np.cumsum([0, *sizes[:-1]])
    rows = zip(target.models.layout.groups, firsts, sizes, strict=True)
    found = [np.arange(first, first + size) for group, first, size in rows if group.name in parts]
    return np.concatenate([np.empty(0, np.int64), *found]).astype(np.int64)


def refit_group(target: RefitTarget, free: I) -> F:
    """Return theta with the parameters at the places `free` refitted within their bounds."""
    layout, start = target.models.layout, target.theta

    def embed(values: F) -> F:
        theta = start.copy()
        theta[free] = values
        return theta

    def equations(values: F) -> tuple[float, F, F]:
        error, matrix, gradient = target.models.normal_equations(embed(values), target.weights)
        return error, matrix[np.ix_(free, free)], gradient[free]

    problem = BoundedProblem(
        lambda values: target.models.error(embed(values), target.weights),
        equations,
        lambda values: layout.project(embed(values))[free],
        layout.low[free],
        layout.high[free],
        layout.penalty_weight(PENALTY) / layout.scale[free] ** 2,
        start[free],
    )
    theta = start
    for _, values in islice(descend_within_bounds(problem, start[free]), MAX_STEPS):
        theta = embed(values)
    return theta


def measure_movement(target: RefitTarget, free: I, at: Linearisation, change: F) -> Movement:
    """Return the movement to a linearisation from `change` (n,) before it, plus the step that is left there.

    Its covariance counts each block as one sample (White, Econometrica 50, 1982).
    """
    layout = target.models.layout
    pull = np.diag(layout.penalty_weight(PENALTY) / layout.scale[free] ** 2)
    inverse = np.linalg.inv(at.matrix[np.ix_(free, free)] + pull)
    used = at.gradients[(at.gradients != 0.0).any(axis=1)][:, free]
    left = -inverse @ (used.sum(axis=0) + pull @ change)
    root = inverse @ (used - used.mean(axis=0)).T
    spare = max(len(used) - len(free), 1)
    return Movement(free, change + left, root @ root.T * len(used) / spare)


def compare_movements(real: Movement, control: Movement | None) -> float:
    """Return by how many standard errors a movement differs from that of the control (or from none).

    Several parameters count by the standard error of a normal variable that is as improbable.
    """
    difference = real.change if control is None else real.change - control.change
    covariance = real.covariance if control is None else real.covariance + control.covariance
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    whole = covariance / np.outer(scale, scale) + 1e-6 * np.eye(len(scale))
    square = float((difference / scale) @ np.linalg.solve(whole, difference / scale))
    if len(scale) == 1:
        return min(float(np.sqrt(square)), MAX_Z)
    return min(float(norm.isf(max(float(chi2.sf(square, len(scale))) / 2.0, 1e-300))), MAX_Z)
