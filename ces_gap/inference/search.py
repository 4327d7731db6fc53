"""Which effects explain the gap: every form is fitted alone, then compositions are searched with joint refits."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from ces_gap.effects.effect import Effect
from ces_gap.inference.anchored_surrogate import Refinement
from ces_gap.inference.comparison import MIN_GAIN_SHARE, cost_with_penalty
from ces_gap.inference.composition_search import CompositionSearch
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import EffectFit, fit_alone
from ces_gap.inference.nested_forms import order_nested_forms
from ces_gap.progress import Progress, ignore_progress
from ces_gap.trace import F

MAX_REFINED_FORMS = 10
REFINE_WITHIN_SHARE = 0.4  # of the gap's energy: a form that leaves more than the best by this is not refined
MIN_GAP_ENERGY = 0.02  # share of the noise's energy: a smaller gap counts as this large
MIN_FORM_GAIN_SHARE = 0.02  # of the gap's energy that a form with more parameters must gain


@dataclass(frozen=True)
class EffectSearchResult:
    """`baseline_residual` (r,) is the whitened residual without effects; `alone` the best form of each effect, ranked.

    `tried` are compositions of as many effects as the best, refitted with one of its effects replaced.
    """

    baseline_residual: F
    alone: tuple[EffectFit, ...]
    best: EffectFit | None
    gap_energy: float  # whitened sum of squares above the noise's
    evidence: Evidence
    tried: tuple[EffectFit, ...] = ()


def search(
    evidence: Evidence,
    effects: Sequence[Effect],
    refinement: Refinement,
    threads: int,
    progress: Progress = ignore_progress,
    min_gain_share: float = MIN_GAIN_SHARE,
) -> EffectSearchResult:
    """Return the best explanations of the evidence by the effects.

    `refinement` repeats the most promising fits with the simulation itself where the evidence holds a surrogate. Each
    further effect must explain `min_gain_share` of the gap's energy.
    """
    forms: list[EffectFit] = []
    with ThreadPoolExecutor(max(1, threads)) as pool:
        for fit in pool.map(lambda effect: fit_alone(evidence, effect), effects):
            forms.append(fit)
            progress(f"fitting {fit.names[0]}", len(forms) / len(effects))
    residual = evidence.residual(evidence.alone)
    energy = max(float(residual @ residual) - len(residual), MIN_GAP_ENERGY * len(residual))
    forms.sort(key=lambda f: f.cost)
    limit = forms[0].cost + REFINE_WITHIN_SHARE * energy
    for k, fit in enumerate([f for f in forms[:MAX_REFINED_FORMS] if f.cost < limit]):
        progress(f"running the simulation with {fit.names[0]}", k / MAX_REFINED_FORMS)
        forms[k] = refinement.refine(evidence, fit)
    alone = order_nested_forms(evidence, best_forms(forms, energy))
    compositions = CompositionSearch(evidence, residual, forms, energy, refinement, threads, min_gain_share)
    best = compositions.grow(alone, progress)
    tried: tuple[EffectFit, ...] = ()
    if best is not None and len(best.effects) > 1:
        progress("trying other effects in place of each", 0.0)
        best, tried = compositions.improve(best)
    return EffectSearchResult(residual, alone, best, energy, evidence, tried)


def best_forms(forms: Sequence[EffectFit], energy: float) -> tuple[EffectFit, ...]:
    """Return one form of each effect, best first: one with more parameters only if it explains clearly more."""
    chosen: dict[str, EffectFit] = {}
    for fit in sorted(forms, key=lambda f: len(f.searched)):
        simpler = chosen.get(fit.names[0])
        min_gain = MIN_FORM_GAIN_SHARE * energy if simpler and len(fit.searched) > len(simpler.searched) else 0.0
        if simpler is None or fit.cost < simpler.cost - min_gain:
            chosen[fit.names[0]] = fit
    return tuple(sorted(chosen.values(), key=lambda f: cost_with_penalty(f, energy)))
