"""Search for compositions: effects are added by beam search, then each is removed or replaced and the rest refitted.

The data left out decide. A composition grows only while the paired gain exceeds twice its error and a twentieth of the
gap. The replacements that were fitted are returned as well, because they may be alternatives (`alternatives.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ces_gap.inference.anchored_surrogate import Refinement
from ces_gap.inference.comparison import MIN_GAIN_SHARE, choose_best_fit, is_worthwhile, prior_cost
from ces_gap.inference.compositions import fit_each, rank_additions, split_composition
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import EffectFit, fit_together
from ces_gap.progress import Progress
from ces_gap.trace import F

BEAM = 2
MAX_EFFECTS = 3
MAX_ADDITIONS = 3  # additions refitted jointly for each composition in the beam
MAX_SWAPS = 3  # replacements fitted for each effect
MAX_REFINED_SWAPS = 2  # the best of these
REFINE_WITHIN_SHARE = 0.2  # of the gap's energy: a replacement that leaves more than the best by this is not refined


@dataclass(frozen=True)
class CompositionSearch:
    """`baseline_residual` (r,) is the whitened residual without effects, `forms` their own fits, `energy` the gap's."""

    evidence: Evidence
    baseline_residual: F
    forms: Sequence[EffectFit]
    energy: float
    refinement: Refinement
    threads: int = 1
    min_gain_share: float = MIN_GAIN_SHARE  # of the gap's energy that each further effect must explain

    def grow(self, alone: Sequence[EffectFit], progress: Progress) -> EffectFit | None:
        """Return the best composition, None if no single effect gains more than its error."""
        beam = list(alone[:BEAM])
        best = beam[0] if beam and self._is_gain(beam[0]) else None
        for size in range(2, MAX_EFFECTS + 1):
            if best is None or best.cost - len(self.baseline_residual) < self.min_gain_share * self.energy:
                break
            progress(f"trying {size} effects together", (size - 1) / MAX_EFFECTS)
            limit = best.cost
            joint = sorted((f for f in self._fit_additions(beam) if f.cost < limit), key=lambda f: f.cost)
            beam = [self.refinement.refine(self.evidence, fit) for fit in joint[:BEAM]]
            better = choose_best_fit(self.evidence, [best, *beam], self.energy)
            if not self._is_necessary(better, best):
                break
            best = better
        return best

    def improve(
        self, best: EffectFit, tried: tuple[EffectFit, ...] = (), fixed: Sequence[str] = ()
    ) -> tuple[EffectFit, tuple[EffectFit, ...]]:
        """Return the composition after removals that cost nothing and replacements that leave less; and the fits tried.

        `fixed` effects are not replaced. A composition with a replacement is improved in turn.
        """
        close = self.refinement.anchor(self.evidence, best)
        fewer = {name: self._fit_without(close, best, name) for name in best.names}
        for fit in sorted(fewer.values(), key=lambda f: f.cost):
            if self._is_necessary(best, fit):
                continue
            refined = self.refinement.refine(self.evidence, fit)
            if not self._is_necessary(best, refined):
                return self.improve(refined) if len(refined.effects) > 1 else (refined, ())
        for name in [n for n in best.names if n not in fixed]:
            swapped = self._fit_swaps(close, best, fewer[name])
            better = choose_best_fit(self.evidence, [best, *swapped], self.energy)
            if better is not best:
                others = tuple(f for f in swapped if f is not better)
                return self.improve(better, (*tried, *others, best), tuple(set(better.names) - set(best.names)))
            tried = (*tried, *swapped)
        return best, tried

    def _fit_additions(self, beam: Sequence[EffectFit]) -> list[EffectFit]:
        """Return each fit in the beam refitted with its most promising additions, no composition twice."""
        jobs: dict[frozenset[str], tuple[Evidence, list[EffectFit]]] = {}
        for fit in beam:
            close = self.refinement.anchor(self.evidence, fit)
            for other in rank_additions(fit, self.forms, self.baseline_residual)[:MAX_ADDITIONS]:
                parts = [*split_composition(fit, self.forms), other]
                jobs.setdefault(frozenset((*fit.names, *other.names)), (close, parts))
        return fit_each(list(jobs.values()), self.threads)

    def _fit_without(self, close: Evidence, best: EffectFit, name: str) -> EffectFit:
        return fit_together(close, [p for p in split_composition(best, self.forms) if p.names[0] != name])

    def _is_gain(self, fit: EffectFit) -> bool:
        return is_worthwhile(self.evidence, self.baseline_residual, fit, prior_cost(fit, self.energy))

    def _is_necessary(self, best: EffectFit, fewer: EffectFit) -> bool:
        added = prior_cost(best, self.energy) - prior_cost(fewer, self.energy)
        return is_worthwhile(self.evidence, fewer.left_out, best, self.min_gain_share * self.energy + added)

    def _fit_swaps(self, close: Evidence, best: EffectFit, fewer: EffectFit) -> list[EffectFit]:
        """Return the most promising compositions of `fewer` and an effect that is not in `best`, refined."""
        ranked = rank_additions(fewer, self.forms, self.baseline_residual)
        others = [f for f in ranked if f.names[0] not in best.names][:MAX_SWAPS]
        joint = fit_each([(close, [*split_composition(fewer, self.forms), other]) for other in others], self.threads)
        limit = best.cost + REFINE_WITHIN_SHARE * self.energy
        promising = sorted((f for f in joint if f.cost < limit), key=lambda f: f.cost)
        return [self.refinement.refine(self.evidence, fit) for fit in promising[:MAX_REFINED_SWAPS]]
