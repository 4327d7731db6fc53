"""The search for terms: seeded starts in threads, by random selection, Gauss-Newton gain, both, or as in the thesis."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np

from ces_data.arrays import F, I
from ces_identify.numerics import kernels
from ces_identify.polynomial.gauss_newton import GaussNewtonStart
from ces_identify.polynomial.problem import Problem
from ces_identify.polynomial.search_limits import (
    BOTH,
    GAUSS_NEWTON,
    THESIS,
    Limits,
    Listener,
    SearchResult,
    SearchStart,
    run_starts,
    spread_work,
)

BATCH = 32  # candidates tried between two checks of the work
FEW_TERMS = 6  # with which a random start begins; a search for more terms goes on from that model
RIDGE = 1e-9  # smallest pivot of the scaled Gram matrix; columns with a smaller one count as dependent


class LeastSquaresStart(SearchStart):
    """A start whose models are fitted by least squares with measured past forces and judged by their free run."""

    work = 1.2e9

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
        limits = bound, RIDGE, p.probes, p.max_gain
        place, cost, coefficients = kernels.first_better(p.gram, chosen, trial, p.run, p.compiled.arrays, *limits, drop)
        self.trials += len(trial) if place < 0 else place + 1
        return int(place), float(cost), coefficients


GAINS = (0.2, 0.05, 0.02, 0.007, 0.003)  # relative gain required of a new term, one after the other
PRUNE_LOSS = 0.001  # relative loss below which a term is pruned
SHAKE_SHARE = 0.4  # share of the terms removed at the beginning of a round


class RandomForwardStart(LeastSquaresStart):
    """Random forward selection with pruning by free-run cost (from thesis fig. 3.2).

    A start tries candidates in random order. It adds a candidate if the model with it, fitted by least squares on the
    estimation ticks, lowers the cost of the free run on the selection ticks; after every success it prunes the terms
    that are no longer needed. The required gain decreases step by step, so that strong terms come first. When no
    candidate is left, the start removes a random part of its best model and searches again, for a number of rounds
    (iterated local search). It stops after the last round, at the target cost, or with its work done. Its current model
    may be worse than the best one of an earlier round.
    """

    def _search(self) -> None:
        """Search, then remove random terms and search again in each round."""
        self._climb()
        for _ in range(self.limits.rounds):
            if self._reason_to_end():
                break
            best, n = self.current, len(self.current.chosen)
            kept = self.random.permutation(n)[: max(1, round((1.0 - SHAKE_SHARE) * n))]
            less = best.chosen[np.sort(kept)]
            place, cost, coefficients = self._try(less[:-1], less[-1:], np.inf, False)
            if place < 0:
                less, cost, coefficients = np.empty(0, np.int64), np.inf, np.empty(0)
            self.current = self._result(less, coefficients, cost)
            self._climb(best.cost)
            if self.current.cost >= best.cost:
                self.current = best

    def _climb(self, best: float = np.inf) -> None:
        """Add and prune terms until no candidate gives the least gain; report models that cost less than `best`."""
        for gain in GAINS:
            while self._add_one_term(gain):
                if self.current.cost < best:
                    self.listener(self.current)

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


class ThesisStart(LeastSquaresStart):
    """The regressor selection of the thesis, to the letter (section 3.4.4, fig. 3.2); the current model is the best.

    It starts from an initial model. One random candidate is added and removed from the list; it stays if the free-run
    cost is lower at all. Then one regressor at a time is removed; the best smaller model replaces the model if it costs
    less, and pruning starts over. The procedure ends when the list is empty, at the target cost, or with its work done.
    Nothing keeps a model stable. The thesis estimates parameters one step ahead (`nlarx`): least squares on the
    estimation ticks here, whose validation data are the selection ticks. It has no limit on the number of terms, unless
    `terms` is given.
    """

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


def search(problem: Problem, limits: Limits, listener: Listener = lambda result: None) -> list[SearchResult]:
    """Run the starts in parallel threads; return their results, best first.

    Ctrl-C stops every start and returns the best so far, or raises KeyboardInterrupt if there is none. `listener`
    receives each improvement and each start's result, from the threads.
    """
    limits = spread_work(limits, len(problem.measured))

    def start(seed: int, deadline: float, stop: threading.Event) -> SearchResult:
        arguments = problem, limits, seed, deadline, stop, listener
        if limits.method == THESIS:
            return ThesisStart(*arguments).run()
        if limits.method == GAUSS_NEWTON or (limits.method == BOTH and (seed - limits.seed) % 2 == 0):
            return GaussNewtonStart(*arguments).run()
        few = replace(limits, terms=min(FEW_TERMS, limits.term_limit))
        result = RandomForwardStart(problem, few, *arguments[2:]).run()
        if limits.method == BOTH:
            return GaussNewtonStart(*arguments, result).run()
        return RandomForwardStart(*arguments, result).run() if limits.term_limit > FEW_TERMS else result

    return run_starts(limits, start)
