"""A composition contested: each of its effects is left out, and others are put in its place and refitted with the rest.

What was put there is kept, the winner or not: an effect that stands in for another as well is told (`rivals.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_gap.inference.anchored import Refinement
from ces_gap.inference.comparison import LEAST_SHARE, preferred, worth
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import Fit, fit_together
from ces_gap.inference.joining import fit_each, parts, ranked

F = NDArray[np.float64]

SWAPS = 3  # effects put in the place of each
REFINED = 2  # of them, the best
WITHIN = 0.2  # share of the gap's energy by which a swap may be behind and still be refined


@dataclass(frozen=True)
class Contest:
    """`none` (r,) is the whitened residual without effects, `forms` their own fits, `energy` the gap's.

    `refinement` redoes a fit with the simulation itself, and makes evidence whose surrogate is right around a fit.
    """

    evidence: Evidence
    none: F
    forms: Sequence[Fit]
    energy: float
    refinement: Refinement
    threads: int = 1

    def won(self, best: Fit, tried: tuple[Fit, ...] = (), settled: Sequence[str] = ()) -> tuple[Fit, tuple[Fit, ...]]:
        """Return the composition after deletions that cost nothing and swaps that leave less; and what was tried.

        No others are put in the place of `settled` effects. A swap that leaves less is contested in turn.
        """
        close = self.refinement.anchor(self.evidence, best)
        fewer = {name: self._without(close, best, name) for name in best.names}
        for one in sorted(fewer.values(), key=lambda f: f.cost):
            if not self._needs(best, one) and not self._needs(best, one := self.refinement.refine(self.evidence, one)):
                return self.won(one) if len(one.effects) > 1 else (one, ())
        for name in [n for n in best.names if n not in settled]:
            swapped = self._swapped(close, best, fewer[name])
            better = preferred(self.evidence, [best, *swapped], self.energy)
            if better is not best:
                others = tuple(f for f in swapped if f is not better)
                return self.won(better, (*tried, *others, best), tuple(set(better.names) - set(best.names)))
            tried = (*tried, *swapped)
        return best, tried

    def _without(self, close: Evidence, best: Fit, name: str) -> Fit:
        return fit_together(close, [p for p in parts(best, self.forms) if p.names[0] != name])

    def _needs(self, best: Fit, fewer: Fit) -> bool:
        return worth(self.evidence, fewer.left_out, best, LEAST_SHARE * self.energy)

    def _swapped(self, close: Evidence, best: Fit, fewer: Fit) -> list[Fit]:
        """Return the most promising compositions with another effect in the place of one, refined."""
        others = [f for f in ranked(fewer, self.forms, self.none) if f.names[0] not in best.names][:SWAPS]
        joint = fit_each([(close, [*parts(fewer, self.forms), other]) for other in others], self.threads)
        hopeful = sorted((f for f in joint if f.cost < best.cost + WITHIN * self.energy), key=lambda f: f.cost)
        return [self.refinement.refine(self.evidence, fit) for fit in hopeful[:REFINED]]
