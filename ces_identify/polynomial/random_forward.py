"""Random forward selection with pruning by free-run cost (from thesis fig. 3.2): one seeded start of a search.

A start tries candidates in random order. It adds a candidate if the model with it, fitted by least squares on the
estimation ticks, lowers the cost of the free run on the selection ticks; after every success it prunes the terms that
are no longer needed. The required gain decreases step by step, so that strong terms come first. When no candidate is
left, the start removes a random part of its best model and searches again, for a number of rounds (iterated local
search). It stops after the last round, at the target cost, or when time is up.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ces_identify.polynomial.least_squares_start import BATCH, LeastSquaresStart
from ces_identify.polynomial.search_limits import SearchResult

GAINS = (0.2, 0.05, 0.02, 0.007, 0.003)  # relative gain required of a new term, one after the other
PRUNE_LOSS = 0.001  # relative loss below which a term is pruned
SHAKE_SHARE = 0.4  # share of the terms removed at the beginning of a round


class RandomForwardStart(LeastSquaresStart):
    """One start; its current model may be worse than the best one of an earlier round."""

    def run(self) -> SearchResult:
        """Search, then remove random terms and search again in each round; return the best model."""
        self._climb()
        for _ in range(self.limits.rounds):
            if self._reason_to_end():
                break
            best = self.current
            self._shake()
            self._climb(best.cost)
            if self.current.cost >= best.cost:
                self.current = best
        ended = self._reason_to_end() or "no candidates left"
        self.current = replace(self.current, trials=self.trials, ended=ended)
        self.listener(self.current)
        return self.current

    def _climb(self, best: float = np.inf) -> None:
        """Add and prune terms until no candidate gives the least gain; report models that cost less than `best`."""
        for gain in GAINS:
            while self._add_one_term(gain):
                if self.current.cost < best:
                    self.listener(self.current)

    def _shake(self) -> None:
        """Remove a random part of the terms."""
        n = len(self.current.chosen)
        keep = self.random.permutation(n)[: max(1, round((1.0 - SHAKE_SHARE) * n))]
        less = self.current.chosen[np.sort(keep)]
        place, cost, coefficients = self._try(less[:-1], less[-1:], np.inf, False)
        if place < 0:
            less, cost, coefficients = np.empty(0, np.int64), np.inf, np.empty(0)
        self.current = self._result(less, coefficients, cost)

    def _add_one_term(self, gain: float) -> bool:
        """Try candidates in random order until one lowers the cost by `gain`, then prune; False if none does."""
        order = self.random.permutation(np.setdiff1d(np.arange(len(self.problem.candidates)), self.current.chosen))
        at = 0
        while at < len(order):
            if self._reason_to_end():
                return False
            trial = order[at : at + BATCH]
            place, grown = self._add_first_better(self.current, trial, self.current.cost * (1.0 - gain))
            if grown is None:
                at += len(trial)
                continue
            at += place + 1
            pruned = self._prune(grown, ceiling=self.current.cost * (1.0 - gain))
            if pruned is not None:
                self.current = pruned
                return True
        return False

    def _prune(self, model: SearchResult, ceiling: float) -> SearchResult | None:
        """Return `model` without the terms it does not need; None if it stays above the term limit."""
        while len(model.chosen) > 1:
            over = len(model.chosen) > self.limits.term_limit
            bound = ceiling if over else min(ceiling, model.cost * (1.0 + PRUNE_LOSS))
            smaller = self._remove_weakest_term(model, bound)
            if smaller is None:
                return None if over else model
            model = smaller
        return model
