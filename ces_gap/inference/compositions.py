"""Putting effects together: the parts of a composition, and which effect promises most beside those that are there."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import EffectFit, fit_together

F = NDArray[np.float64]


def fit_each(jobs: Sequence[tuple[Evidence, Sequence[EffectFit]]], threads: int) -> list[EffectFit]:
    """Return the joint fit of each job's parts on its evidence, so many at once."""
    with ThreadPoolExecutor(max(1, threads)) as pool:
        return list(pool.map(lambda job: fit_together(*job), jobs))


def split_composition(fit: EffectFit, forms: Sequence[EffectFit]) -> list[EffectFit]:
    """Return the single fits that a composition is made of, begun where the composition ended."""
    made, first = [], 0
    for effect in fit.effects:
        single = next(f for f in forms if f.effects[0] == effect)
        count = len(effect.parameters)
        made.append(replace(single, searched=fit.searched[first : first + count]))
        first += count
    return made


def fits_of_other_effects(alone: Sequence[EffectFit], names: Sequence[str]) -> list[EffectFit]:
    """Return the fits of other effects."""
    return [f for f in alone if f.names[0] not in names]


def rank_additions(fit: EffectFit, forms: Sequence[EffectFit], baseline_residual: F) -> list[EffectFit]:
    """Return one form of each effect that is not there by what it promises beside `fit`, most first.

    `baseline_residual` (r,) is the whitened residual without effects. What counts is the squares that a linear step
    explains, along the tangents and the signature as fitted: one effect bends where the other stands on its bound.
    """
    first: dict[str, EffectFit] = {}
    for other in sorted(
        fits_of_other_effects(forms, fit.names), key=lambda form: -_linear_gain(fit, form, baseline_residual)
    ):
        first.setdefault(other.names[0], other)
    return list(first.values())


def _linear_gain(fit: EffectFit, other: EffectFit, none: F) -> float:
    tangents = np.column_stack([fit.jacobian, other.jacobian, none - other.residual])
    scale = np.linalg.norm(tangents, axis=0)
    tangents = tangents[:, scale > 0.0] / scale[scale > 0.0]
    gram = tangents.T @ tangents + 1e-6 * np.eye(tangents.shape[1])
    slope = tangents.T @ fit.residual
    return float(slope @ np.linalg.solve(gram, slope))
