"""The refit of one group of parameters, the others held, and how clearly other recordings ask for the same change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ces_gap.trace import F
from ces_gap.witness.target import RefitTarget
from ces_identify.numerics.bounded_levenberg import BoundedProblem, descend_within_bounds

MAX_STEPS = 4
PENALTY = 0.003  # [J %] of a change of one parameter by its scale: holds what the recordings do not determine

Places = NDArray[np.int64]


@dataclass(frozen=True)
class Amplitude:
    """The share of a change of force that recordings ask for (1: all of it), with its standard error."""

    value: float
    error: float

    @property
    def z(self) -> float:
        """The amplitude in standard errors."""
        return self.value / max(self.error, 1e-12)


def places_of(target: RefitTarget, parts: Sequence[str]) -> Places:
    """Return the places in theta of the named parts of the layout that the model has."""
    sizes = [len(g.start) for g in target.models.layout.groups]
    firsts = np.cumsum([0, *sizes[:-1]])
    rows = zip(target.models.layout.groups, firsts, sizes, strict=True)
    found = [np.arange(first, first + size) for group, first, size in rows if group.name in parts]
    return np.concatenate([np.empty(0, np.int64), *found]).astype(np.int64)


def refit_group(target: RefitTarget, free: Places) -> F:
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


def predict_gain(target: RefitTarget, free: Places, matrix: F, gradient: F) -> float:
    """Return the share of the squared error that one step of the parameters at the places `free` would gain.

    `matrix` (n, n) and `gradient` (n,) are those of half the squared error by all parameters.
    """
    step = np.linalg.lstsq(matrix[np.ix_(free, free)], gradient[free], rcond=1e-9)[0]
    return float(gradient[free] @ step) / max(target.models.error(target.theta, target.weights), 1e-300)


def measure_amplitude(target: RefitTarget, theta: F) -> Amplitude:
    """Return how much of the change of force from the baseline to `theta` the target's recordings ask for.

    It is the regression of the baseline's error on the change; each block counts as one sample in its standard error
    (White, Econometrica 50, 1982).
    """
    before = target.models.force(target.theta)
    change = np.where(target.weights > 0.0, target.models.force(theta) - before, 0.0)
    size = max(float(change @ change), 1e-300)
    value = float(change @ (target.models.training.measured - before)) / size
    rest = change * (target.models.training.measured - before - value * change)
    scores = np.bincount(target.blocks, rest)
    used = np.bincount(target.blocks, target.weights) > 0.0
    spare = max(int(used.sum()) - 1, 1)
    return Amplitude(value, float(np.sqrt((scores[used] ** 2).sum() * used.sum() / spare)) / size)


def subtract_control(real: Amplitude, control: Amplitude | None) -> float:
    """Return by how many standard errors the real recordings ask for more of the change than the references do."""
    if control is None:
        return real.z
    return (real.value - control.value) / max(float(np.hypot(real.error, control.error)), 1e-12)
