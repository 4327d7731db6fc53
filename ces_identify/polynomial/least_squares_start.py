"""A start of a search that tries terms one at a time: least squares on the estimation ticks, free run on the others."""

from __future__ import annotations

import numpy as np

from ces_identify.numerics import kernels
from ces_identify.numerics.arrays import F, I
from ces_identify.polynomial.search_limits import SearchResult
from ces_identify.polynomial.search_start import SearchStart

BATCH = 32  # candidates tried between two checks of the clock
RIDGE = 1e-9  # smallest pivot of the scaled Gram matrix; columns with a smaller one count as dependent


class LeastSquaresStart(SearchStart):
    """A start whose models are fitted by least squares with measured past forces and judged by their free run."""

    def _add_first_better(self, model: SearchResult, trial: I, bound: float) -> tuple[int, SearchResult | None]:
        """Return the place in `trial` of the first candidate that gives a cost below `bound`, and that model.

        The place is -1 if none does.
        """
        place, cost, coefficients = self._try(model.chosen, trial, bound, False)
        return place, self._result(np.append(model.chosen, trial[place]), coefficients, cost) if place >= 0 else None

    def _remove_weakest_term(self, model: SearchResult, bound: float) -> SearchResult | None:
        """Return `model` without the term whose removal costs least, if that keeps the cost below `bound`."""
        best: SearchResult | None = None
        places = self.random.permutation(len(model.chosen))
        at = 0
        while at < len(places):
            place, cost, coefficients = self._try(model.chosen, places[at:], bound, True)
            if place < 0:
                break
            best = self._result(np.delete(model.chosen, places[at + place]), coefficients, cost)
            bound = cost
            at += place + 1
        return best

    def _try(self, chosen: I, trial: I, bound: float, drop: bool) -> tuple[int, float, F]:
        p = self.problem
        limits = bound, RIDGE, p.probes, p.max_gain
        place, cost, coefficients = kernels.first_better(p.gram, chosen, trial, p.run, p.compiled.arrays, *limits, drop)
        self.trials += len(trial) if place < 0 else place + 1
        return int(place), float(cost), coefficients

    def _result(self, chosen: I, coefficients: F, cost: float) -> SearchResult:
        return SearchResult(chosen, coefficients, cost, self.seed, self.trials, "running")
