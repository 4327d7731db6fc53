"""A composition contested: each of its effects is left out, and others are put in its place and refitted with the rest.

What was put there is kept, the winner or not: an effect that stands in for another as well is told (`alternatives.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_gap.inference.anchored_surrogate import Refinement
from ces_gap.inference.comparison import MIN_GAIN_SHARE, choose_best_fit, is_worthwhile
from ces_gap.inference.compositions import fit_each, rank_additions, split_composition
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import EffectFit, fit_together

F = NDArray[np.float64]

MAX_SWAPS = 3  # effects put in the place of each
MAX_REFINED_SWAPS = 2  # of them, the best
REFINE_WITHIN_SHARE = 0.2  # share of the gap's energy by which a swap may be behind and still be refined


@dataclass(frozen=True)
class SwapSearch:
    """`baseline_residual` (r,) is the whitened residual without effects, `forms` their own fits, `energy` the gap's.

    `refinement` redoes a fit with the simulation itself, and makes evidence whose surrogate is right around a fit.
    """

    evidence: Evidence
    baseline_residual: F
    forms: Sequence[EffectFit]
    energy: float
    refinement: Refinement
    threads: int = 1

    def improve(
        self, best: EffectFit, tried: tuple[EffectFit, ...] = (), fixed: Sequence[str] = ()
    ) -> tuple[EffectFit, tuple[EffectFit, ...]]:
        """Return the composition after deletions that cost nothing and swaps that leave less; and what was tried.

        No others are put in the place of `fixed` effects. A swap that leaves less is contested in turn.
        """
        close = self.refinement.anchor(self.evidence, best)
        fewer = {name: self._without(close, best, name) for name in best.names}
        for one in sorted(fewer.values(), key=lambda f: f.cost):
            if not self._is_necessary(best, one) and not self._is_necessary(
                best, one := self.refinement.refine(self.evidence, one)
            ):
                return self.improve(one) if len(one.effects) > 1 else (one, ())
        for name in [n for n in best.names if n not in fixed]:
            swapped = self._fit_swaps(close, best, fewer[name])
            better = choose_best_fit(self.evidence, [best, *swapped], self.energy)
            if better is not best:
                others = tuple(f for f in swapped if f is not better)
                return self.improve(better, (*tried, *others, best), tuple(set(better.names) - set(best.names)))
            tried = (*tried, *swapped)
        return best, tried

    def _without(self, close: Evidence, best: EffectFit, name: str) -> EffectFit:
        return fit_together(close, [p for p in split_composition(best, self.forms) if p.names[0] != name])

    def _is_necessary(self, best: EffectFit, fewer: EffectFit) -> bool:
        return is_worthwhile(self.evidence, fewer.left_out, best, MIN_GAIN_SHARE * self.energy)

    def _fit_swaps(self, close: Evidence, best: EffectFit, fewer: EffectFit) -> list[EffectFit]:
        """Return the most promising compositions with another effect in the place of one, refined."""
        others = [f for f in rank_additions(fewer, self.forms, self.baseline_residual) if f.names[0] not in best.names][
            :MAX_SWAPS
        ]
        joint = fit_each([(close, [*split_composition(fewer, self.forms), other]) for other in others], self.threads)
        hopeful = sorted(
            (f for f in joint if f.cost < best.cost + REFINE_WITHIN_SHARE * self.energy), key=lambda f: f.cost
        )
        return [self.refinement.refine(self.evidence, fit) for fit in hopeful[:MAX_REFINED_SWAPS]]
