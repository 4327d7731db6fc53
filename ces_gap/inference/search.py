"""Which effects: every form alone, then compositions by beam search with joint refits, contested at the end.

The data left out decide. A composition grows only while the paired gain there exceeds twice its error and a twentieth
of the gap. Signatures order what is tried next, and never decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ces_gap.effects.effect import Effect
from ces_gap.inference.anchored_surrogate import Refinement
from ces_gap.inference.comparison import MIN_GAIN_SHARE, choose_best_fit, cost_with_penalty, is_worthwhile
from ces_gap.inference.compositions import fit_each, rank_additions, split_composition
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import EffectFit, fit_alone
from ces_gap.inference.swap_search import SwapSearch
from ces_gap.progress import Progress, ignore_progress

F = NDArray[np.float64]

BEAM = 2
MAX_ADDITIONS = 3  # additions refitted jointly for each composition in the beam
MAX_EFFECTS = 3
MAX_REFINED_FORMS, REFINE_WITHIN_SHARE = (
    10,
    0.4,
)  # forms that are refined: so many, and within so much of the gap's energy of the best
MIN_GAP_ENERGY = 0.02  # of the noise's: a smaller gap is not looked into
MIN_FORM_GAIN_SHARE = 0.02  # share of the gap's energy that a form with more parameters must win


@dataclass(frozen=True)
class EffectSearchResult:
    """`baseline_residual` (r,) is the whitened residual without effects; `alone` the best form of each effect, best
    first.

    `tried` are compositions of as many effects as the best, refitted with one of its effects replaced.
    """

    baseline_residual: F
    forms: tuple[EffectFit, ...]
    alone: tuple[EffectFit, ...]
    best: EffectFit | None
    gap_energy: float  # whitened squares above the noise's
    evidence: Evidence
    tried: tuple[EffectFit, ...] = ()


def search(
    evidence: Evidence,
    effects: Sequence[Effect],
    refinement: Refinement,
    threads: int,
    progress: Progress = ignore_progress,
) -> EffectSearchResult:
    """Return the best explanations of the evidence by the effects.

    `refinement` redoes the most promising fits with the simulation itself where the evidence has only a surrogate.
    """
    forms: list[EffectFit] = []
    with ThreadPoolExecutor(max(1, threads)) as pool:
        for fit in pool.map(lambda effect: fit_alone(evidence, effect), effects):
            forms.append(fit)
            progress(f"fitting {fit.names[0]}", len(forms) / len(effects))
    if not evidence.noise_known:
        evidence, forms = _limit_noise_to_residual(evidence, forms)
    none = evidence.residual(evidence.alone)
    energy = max(float(none @ none) - len(none), MIN_GAP_ENERGY * len(none))
    forms.sort(key=lambda f: f.cost)
    hopeful = forms[0].cost + REFINE_WITHIN_SHARE * energy
    for k, fit in enumerate([f for f in forms[:MAX_REFINED_FORMS] if f.cost < hopeful]):
        progress(f"running the simulation with {fit.names[0]}", k / MAX_REFINED_FORMS)
        forms[k] = refinement.refine(evidence, fit)
    alone = best_forms(forms, energy)
    best = grow(evidence, none, alone, forms, energy, refinement, threads, progress)
    tried: tuple[EffectFit, ...] = ()
    if best is not None and len(best.effects) > 1:
        progress("trying other effects in their place", 0.0)
        best, tried = SwapSearch(evidence, none, forms, energy, refinement, threads).improve(best)
    return EffectSearchResult(none, tuple(forms), alone, best, energy, evidence, tried)


def _limit_noise_to_residual(evidence: Evidence, forms: Sequence[EffectFit]) -> tuple[Evidence, list[EffectFit]]:
    """Return evidence and fits with noise no stronger than what the best effect leaves.

    Without references the noise is only known to be at most what the generic learner leaves.
    """
    factor = min(1.0, *(float(np.sqrt(f.cost / len(f.left_out))) for f in forms))
    quieter = [
        replace(f, residual=f.residual / factor, jacobian=f.jacobian / factor, left_out=f.left_out / factor)
        for f in forms
    ]
    return evidence.scale_noise(factor), quieter


def best_forms(forms: Sequence[EffectFit], energy: float) -> tuple[EffectFit, ...]:
    """Return one form of each effect, best first: a richer one only if it explains clearly more."""
    chosen: dict[str, EffectFit] = {}
    for fit in sorted(forms, key=lambda f: len(f.searched)):
        held = chosen.get(fit.names[0])
        more = len(fit.searched) - len(held.searched) if held is not None else 0
        if held is None or fit.cost < held.cost - (MIN_FORM_GAIN_SHARE * energy if more > 0 else 0.0):
            chosen[fit.names[0]] = fit
    return tuple(sorted(chosen.values(), key=lambda f: cost_with_penalty(f, energy)))


def grow(
    evidence: Evidence,
    baseline_residual: F,
    alone: Sequence[EffectFit],
    forms: Sequence[EffectFit],
    energy: float,
    refinement: Refinement,
    threads: int,
    progress: Progress,
) -> EffectFit | None:
    """Return the best composition, or None if not even one effect gains more than its error."""
    beam: list[EffectFit] = list(alone[:BEAM])
    best = beam[0] if beam and is_worthwhile(evidence, baseline_residual, beam[0], 0.0) else None
    for size in range(2, MAX_EFFECTS + 1):
        if best is None or best.cost - len(baseline_residual) < MIN_GAIN_SHARE * energy:
            break
        progress(f"trying {size} effects together", (size - 1) / MAX_EFFECTS)
        joint = [
            f for f in _additions(evidence, baseline_residual, beam, forms, refinement, threads) if f.cost < best.cost
        ]
        joint.sort(key=lambda f: f.cost)
        beam = [refinement.refine(evidence, fit) for fit in joint[:BEAM]]
        better = choose_best_fit(evidence, [best, *beam], energy)
        if not is_worthwhile(evidence, best.left_out, better, MIN_GAIN_SHARE * energy):
            break
        best = better
    return best


def _additions(
    evidence: Evidence,
    none: F,
    beam: Sequence[EffectFit],
    forms: Sequence[EffectFit],
    refinement: Refinement,
    threads: int,
) -> list[EffectFit]:
    """Return each fit in the beam refitted with the effects that promise most beside it, no composition twice."""
    made: dict[frozenset[str], tuple[Evidence, list[EffectFit]]] = {}
    for fit in beam:
        close = refinement.anchor(evidence, fit)
        for other in rank_additions(fit, forms, none)[:MAX_ADDITIONS]:
            made.setdefault(frozenset((*fit.names, *other.names)), (close, [*split_composition(fit, forms), other]))
    return fit_each(list(made.values()), threads)
