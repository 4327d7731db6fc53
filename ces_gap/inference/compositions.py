"""Building compositions: splitting one into its effects, and ranking the effects that could be added to it."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import EffectFit, fit_together
from ces_gap.trace import F


def fit_each(jobs: Sequence[tuple[Evidence, Sequence[EffectFit]]], threads: int) -> list[EffectFit]:
    """Return the joint fit of each job's parts on its evidence, in parallel."""
    with ThreadPoolExecutor(max(1, threads)) as pool:
        return list(pool.map(lambda job: fit_together(*job), jobs))


def split_composition(fit: EffectFit, forms: Sequence[EffectFit]) -> list[EffectFit]:
    """Return the single fits of a composition's effects, with the parameters of the composition."""
    singles = [next(f for f in forms if f.effects[0] == effect) for effect in fit.effects]
    stops = np.cumsum([len(effect.parameters) for effect in fit.effects])
    return [replace(f, searched=part) for f, part in zip(singles, np.split(fit.searched, stops[:-1]), strict=True)]


def rank_additions(fit: EffectFit, forms: Sequence[EffectFit], baseline_residual: F) -> list[EffectFit]:
    """Return one form of each effect that is not in `fit`, by its expected gain when added to `fit`, largest first.

    `baseline_residual` (r,) is the whitened residual without effects. The gain is the energy that a linear step along
    the tangents and the fitted signature explains; the signature helps where an effect is on its bound.
    """
    others = [f for f in forms if f.names[0] not in fit.names]
    first: dict[str, EffectFit] = {}
    for other in sorted(others, key=lambda form: -_linear_gain(fit, form, baseline_residual)):
        first.setdefault(other.names[0], other)
    return list(first.values())


def _linear_gain(fit: EffectFit, other: EffectFit, baseline_residual: F) -> float:
    tangents = np.column_stack([fit.jacobian, other.jacobian, baseline_residual - other.residual])
    scale = np.linalg.norm(tangents, axis=0)
    tangents = tangents[:, scale > 0.0] / scale[scale > 0.0]
    gram = tangents.T @ tangents + 1e-6 * np.eye(tangents.shape[1])
    slope = tangents.T @ fit.residual
    return float(slope @ np.linalg.solve(gram, slope))
