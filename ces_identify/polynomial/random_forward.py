"""Random forward selection with pruning, judged by free-run cost (thesis fig. 3.2), as one seeded start of a search.

A start draws candidates in random order. A candidate stays if the model with it, fitted by least squares on the
estimation ticks, lowers the cost of the free run on the selection ticks; after every success each term that is no
longer needed is pruned. The gain asked for falls step by step, so that strong terms come first. When its candidates
are exhausted, a start goes on from its best model less a random part of the terms, for a number of rounds (iterated
local search); it ends after them, when the target cost is reached, or when time is up.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ces_identify.numerics import kernels
from ces_identify.polynomial.limits import SearchResult
from ces_identify.polynomial.search_start import SearchStart

I = NDArray[np.int64]  # noqa: E741

GAINS = (0.2, 0.05, 0.02, 0.007, 0.003)  # relative gain asked of a new term, round by round
PRUNE_LOSS = 0.001  # relative loss at which a term is no longer worth keeping
SHAKE_SHARE = 0.4  # share of the terms taken out at the beginning of a round
BATCH = 32  # candidates tried between two looks at the clock
RIDGE = 1e-9  # least pivot of the scaled Gram matrix, below which columns count as dependent


class RandomForwardStart(SearchStart):
    """One seeded start of the search."""

    def run(self) -> SearchResult:
        """Search, then shake and search again; return the best model."""
        self._climb()
        for _ in range(self.limits.rounds):
            if self._reason_to_end():
                break
            best = self.best
            self._shake()
            self._climb(best.cost)
            if self.best.cost >= best.cost:
                self.best = best
        ended = self._reason_to_end() or "candidates exhausted"
        self.best = replace(self.best, trials=self.trials, ended=ended)
        self.listener(self.best)
        return self.best

    def _climb(self, best: float = np.inf) -> None:
        """Add and prune terms until no candidate gives the least gain; tell what is better than `best`."""
        for gain in GAINS:
            while self._add_one_term(gain):
                if self.best.cost < best:
                    self.listener(self.best)

    def _shake(self) -> None:
        """Take a random part of the terms out."""
        n = len(self.best.chosen)
        keep = self.random.permutation(n)[: max(1, round((1.0 - SHAKE_SHARE) * n))]
        less = self.best.chosen[np.sort(keep)]
        place, cost, coefficients = self._try(less[:-1], less[-1:], np.inf, False)
        if place < 0:
            less, cost, coefficients = np.empty(0, np.int64), np.inf, np.empty(0)
        self.best = SearchResult(less, coefficients, cost, self.seed, self.trials, "running")

    def _add_one_term(self, gain: float) -> bool:
        """Try the candidates in random order until one lowers the cost by `gain`; prune; False when exhausted."""
        order = self.random.permutation(np.setdiff1d(np.arange(len(self.problem.candidates)), self.best.chosen))
        at = 0
        while at < len(order):
            if self._reason_to_end():
                return False
            trial = order[at : at + BATCH]
            place, cost, coefficients = self._try(self.best.chosen, trial, self.best.cost * (1.0 - gain), False)
            if place < 0:
                at += len(trial)
                continue
            at += place + 1
            grown = SearchResult(
                np.append(self.best.chosen, trial[place]), coefficients, cost, self.seed, self.trials, "running"
            )
            pruned = self._prune(grown, ceiling=self.best.cost * (1.0 - gain))
            if pruned is not None:
                self.best = pruned
                return True
        return False

    def _prune(self, found: SearchResult, ceiling: float) -> SearchResult | None:
        """Return `found` without the terms it does not need; None if it cannot be brought under the term limit."""
        while len(found.chosen) > 1:
            over = len(found.chosen) > self.limits.max_terms
            bound = ceiling if over else min(ceiling, found.cost * (1.0 + PRUNE_LOSS))
            smaller = self._remove_weakest_term(found, bound)
            if smaller is None:
                return None if over else found
            found = smaller
        return found

    def _remove_weakest_term(self, found: SearchResult, bound: float) -> SearchResult | None:
        """Return `found` less the term whose loss costs least, if that keeps the cost below `bound`."""
        best: SearchResult | None = None
        places = self.random.permutation(len(found.chosen))
        at = 0
        while at < len(places):
            place, cost, coefficients = self._try(found.chosen, places[at:], bound, True)
            if place < 0:
                break
            chosen = np.delete(found.chosen, places[at + place])
            best = SearchResult(chosen, coefficients, cost, self.seed, self.trials, "running")
            bound = cost
            at += place + 1
        return best

    def _try(self, chosen: I, trial: I, bound: float, drop: bool) -> tuple[int, float, NDArray[np.float64]]:
        p = self.problem
        place, cost, coefficients = kernels.first_better(
            p.gram,
            chosen,
            trial,
            p.powers,
            p.segments,
            p.selection,
            p.measured,
            *p.compiled.arrays,
            *p.force_envelope,
            p.recordings,
            bound,
            RIDGE,
            p.probes,
            p.max_gain,
            drop,
        )
        self.trials += len(trial) if place < 0 else place + 1
        return int(place), float(cost), coefficients
