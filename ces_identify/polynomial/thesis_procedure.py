"""The regressor selection of the thesis, to the letter (section 3.4.4, fig. 3.2): one seeded start of a search.

It starts from an initial model. One random candidate is added and removed from the list; it stays if the free-run cost
is lower at all. Then one regressor at a time is removed; the best smaller model replaces the model if it costs less,
and pruning starts over. The procedure ends when the list is empty, at the target cost, or when time is up. Nothing
keeps a model stable. The thesis estimates parameters one step ahead (`nlarx`): least squares on the estimation ticks
here, whose validation data are the selection ticks. It has no limit on the number of terms, unless `max_terms` is set.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ces_identify.numerics import kernels
from ces_identify.polynomial.least_squares_start import BATCH, RIDGE, LeastSquaresStart
from ces_identify.polynomial.search_limits import SearchResult


class ThesisStart(LeastSquaresStart):
    """One start; its current model is the best so far."""

    def run(self) -> SearchResult:
        """Try every candidate once, in random order; return the model."""
        order = self.random.permutation(np.setdiff1d(np.arange(len(self.problem.candidates)), self.problem.initial))
        at = 0
        while at < len(order) and not self._reason_to_end():
            trial = order[at : at + BATCH]
            place, grown = self._add_first_better(self.current, trial, self.current.cost)
            at += len(trial) if grown is None else place + 1
            pruned = self._prune(grown) if grown is not None else self.current
            if grown is not None and len(pruned.chosen) <= self.limits.term_limit:
                self._keep(pruned)
        ended = self._reason_to_end() or "no candidates left"
        self._keep(replace(self.current, trials=self.trials, ended=ended))
        return self.current

    def _first_model(self) -> SearchResult:
        """Return the problem's initial model; its cost is infinite if its free run diverges."""
        chosen = self.problem.initial
        coefficients, independent = kernels.solve_normal(self.problem.gram, chosen, RIDGE)
        cost = self.problem.selection_cost(chosen, coefficients) if independent else np.inf
        return SearchResult(chosen, coefficients, cost, self.seed, 1, "running")

    def _keep(self, model: SearchResult) -> None:
        self.current = model
        self.listener(model)

    def _prune(self, model: SearchResult) -> SearchResult:
        """Return `model` without the terms whose removal lowers its cost."""
        smaller: SearchResult | None = model
        while smaller is not None:
            model = smaller
            smaller = self._remove_weakest_term(model, model.cost) if len(model.chosen) > 1 else None
        return model
