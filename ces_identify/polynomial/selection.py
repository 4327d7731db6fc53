"""The search for terms: seeded starts in threads, by Gauss-Newton gain or as in the thesis."""

from __future__ import annotations

import threading

import numpy as np

from ces_data.arrays import F, I
from ces_identify.numerics import kernels
from ces_identify.polynomial.gauss_newton import GaussNewtonStart
from ces_identify.polynomial.problem import Problem
from ces_identify.polynomial.search_limits import (
    THESIS,
    Limits,
    Listener,
    SearchResult,
    SearchStart,
    run_starts,
    spread_work,
)

BATCH = 32  # candidates tried between two checks of the work
RIDGE = 1e-9  # smallest pivot of the scaled Gram matrix; columns with a smaller one count as dependent


class ThesisStart(SearchStart):
    """The regressor selection of the thesis, to the letter (section 3.4.4, fig. 3.2); the current model is the best.

    It starts from an initial model. One random candidate is added and removed from the list; it stays if the free-run
    cost is lower at all. Then one regressor at a time is removed; the best smaller model replaces the model if it costs
    less, and pruning starts over. The procedure ends when the list is empty, at the target cost, or with its work done.
    Nothing keeps a model stable. The thesis estimates parameters one step ahead (`nlarx`): least squares on the
    estimation ticks here, whose validation data are the selection ticks. It has no limit on the number of terms, unless
    `terms` is given.
    """

    work = 1.2e9

    def _search(self) -> None:
        """Try every candidate once, in random order."""
        order = self.random.permutation(np.setdiff1d(np.arange(len(self.problem.candidates)), self.problem.initial))
        at = 0
        while at < len(order) and not self._reason_to_end():
            trial = order[at : at + BATCH]
            place, grown = self._add_first_better(self.current, trial, self.current.cost)
            at += len(trial) if grown is None else place + 1
            pruned = self._prune(grown) if grown is not None else self.current
            if grown is not None and len(pruned.chosen) <= self.limits.term_limit:
                self._keep(pruned)

    def _first_model(self) -> SearchResult:
        """Return the problem's initial model; its cost is infinite if its free run diverges."""
        chosen = self.problem.initial
        coefficients, independent = kernels.solve_normal(self.problem.gram, chosen, RIDGE)
        cost = self.problem.selection_cost(chosen, coefficients) if independent else np.inf
        return SearchResult(chosen, coefficients, cost, self.seed, 1, "running")

    def _prune(self, model: SearchResult) -> SearchResult:
        """Return `model` without the terms whose removal lowers its cost."""
        smaller: SearchResult | None = model
        while smaller is not None:
            model = smaller
            smaller = self._remove_weakest_term(model, model.cost) if len(model.chosen) > 1 else None
        return model

    def _add_first_better(self, model: SearchResult, trial: I, bound: float) -> tuple[int, SearchResult | None]:
        """Return the place in `trial` (-1: none) of the first candidate with a cost below `bound`, and that model."""
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
        place, cost, coefficients = kernels.first_better(
            p.gram, chosen, trial, p.run, p.compiled.arrays, bound, RIDGE, drop
        )
        self.trials += len(trial) if place < 0 else place + 1
        return int(place), float(cost), coefficients


def search(problem: Problem, limits: Limits, listener: Listener = lambda result: None) -> list[SearchResult]:
    """Run the starts in parallel threads; return their results, best first.

    Ctrl-C stops every start and returns the best so far, or raises KeyboardInterrupt if there is none. `listener`
    receives each improvement and each start's result, from the threads.
    """
    limits = spread_work(limits, len(problem.measured))

    def start(seed: int, deadline: float, stop: threading.Event) -> SearchResult:
        kind = ThesisStart if limits.method == THESIS else GaussNewtonStart
        return kind(problem, limits, seed, deadline, stop, listener).run()

    return run_starts(limits, start)
