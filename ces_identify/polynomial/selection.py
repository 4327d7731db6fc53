"""The search for terms: seeded starts in threads, by Gauss-Newton gain or as in the thesis.

By gain, a start grows a model with pruning and exchange. The sensitivity of each candidate predicts, to first order,
how much the free-run error on the estimation ticks falls if the candidate is added and all coefficients are adjusted.
The most promising candidates are fitted and the best fit is added; the model with the lowest free-run cost on the
selection ticks is kept. Terms that are no longer needed are pruned; at the end weak terms are exchanged. Each start but
the first considers a random part of the candidates at each step.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from functools import cached_property

import numpy as np

from ces_data.arrays import F, I
from ces_identify.limits import ChoiceLimits
from ces_identify.numerics import kernels
from ces_identify.numerics.search import (
    RUNNING,
    THESIS,
    TIME_IS_UP,
    WORK_IS_DONE,
    Limits,
    Listener,
    SearchResult,
    SearchStart,
    run_starts,
    spread_work,
)
from ces_identify.polynomial.free_run_fit import (
    FreeRunFit,
    candidate_products,
    fit_free_run,
    output_gains,
)
from ces_identify.polynomial.problem import Problem

FITS_PER_STEP = 4  # candidates fitted at a step
PATIENCE = 3  # terms added without success before growth stops
WEAKEST = 3  # terms tried for pruning or exchange
PART = 0.6  # share of the candidates considered at a step, except in the first start
POLES = (0.9, 0.7, 0.97, 0.5)  # of the first models of successive starts
STEPS = 4  # of Levenberg-Marquardt per trial
RUNGS = (*range(2, 13), 15, 20, 25, 30, 40, 50, 70, 100, 140)  # sizes at which weak terms are exchanged
THINNING = 3  # gains are estimated on every third tick, or on fewer if more than MAX_SAMPLED_TICKS remain
MAX_SAMPLED_TICKS = 30_000
DEPENDENT = 1e-6  # least share of a candidate's sensitivity that the model's terms do not span
STEP_SHARES = (1.0, 0.5, 0.2, 0.05)  # shares of a Gauss-Newton step tried


BATCH = 32  # candidates tried between two checks of the work
RIDGE = 1e-9  # smallest pivot of the scaled Gram matrix; columns with a smaller one count as dependent


class TermSearch(ABC):
    """The search of one start; its `current` model is the best so far."""

    work: float  # ticks times trials, at most

    def __init__(self, problem: Problem, start: SearchStart) -> None:
        self.problem, self.start, self.limits = problem, start, start.limits
        self.trials = 0
        start.best = self._first_model()
        self.trials = self.current.trials
        self.budget = max(1.0, self.limits.work * self.work / len(problem.measured)) + self.trials
        self._met = {len(self.current.chosen): self.current}

    @property
    def current(self) -> SearchResult:
        """The best model so far."""
        return self.start.best

    def run(self) -> SearchResult:
        """Search until no candidate helps or a limit is reached or Ctrl-C; return the best model."""
        self._search()
        ended = self._reason_to_end() or "no candidates left"
        self._keep(replace(self.current, trials=self.trials, ended=ended))
        return replace(self.current, share=1.0, met=tuple(self._met.values()))

    @abstractmethod
    def _search(self) -> None:
        """Make `current` the best model that can be found."""

    def _first_model(self) -> SearchResult:
        return self._result(np.empty(0, np.int64), np.empty(0), np.inf)

    def _result(self, chosen: I, coefficients: F, cost: float) -> SearchResult:
        share = min(1.0, self.trials / self.budget) if self.trials else 0.0
        return SearchResult(chosen, coefficients, cost, self.start.seed, self.trials, RUNNING, share)

    def _keep(self, model: SearchResult) -> None:
        self.start.best = model
        best = self._met.get(len(model.chosen))
        if best is None or model.cost <= best.cost:
            self._met[len(model.chosen)] = model
        self.start.listener(model)

    def _reason_to_end(self) -> str:
        return self.start.reason_to_end() or (WORK_IS_DONE if self.trials >= self.budget else "")

    def _must_end(self) -> bool:
        """Return whether the start ends here; when its time is up, it goes on until it has a first model."""
        reason = self._reason_to_end()
        return bool(reason) and (reason != TIME_IS_UP or bool(np.isfinite(self.current.cost)))


class GaussNewtonSearch(TermSearch):
    """One start; its current model is the best so far.

    It climbs from size to size and exchanges weak terms at each: a search for more terms begins as one for fewer does.
    """

    work = 5e7

    @cached_property
    def _sampled_weights(self) -> F:
        """The weights of the ticks on which gains are estimated, 0 elsewhere."""
        weights = self.problem.estimation
        ticks = np.flatnonzero(weights)
        sampled = np.zeros_like(weights)
        sampled[ticks[:: max(THINNING, -(-len(ticks) // MAX_SAMPLED_TICKS))]] = 1.0
        return sampled * weights

    def _search(self) -> None:
        """Grow, prune and exchange until nothing helps, the target is reached, the work is done or Ctrl-C comes."""
        most = self.limits.term_limit
        for size in (*(rung for rung in RUNGS if rung < most and self.limits.exchanges), most):
            before, full = self.current, self._grow(size)
            while self.limits.exchanges and self._exchange_term():
                self._prune()
            if not full and self.current is before:
                return

    def _first_model(self) -> SearchResult:
        """Return the model of a past force alone; candidates are then compared behind a first-order lag.

        Without it if there may be one term only, which must follow the inputs.
        """
        terms, is_possible = self.problem.candidates, self.limits.term_limit > 1
        alone = [i for i, term in enumerate(terms) if is_possible and term.output_lag == 1 and not term.inputs]
        pole = POLES[(self.start.seed - self.limits.seed) % len(POLES)]
        return self._result(np.array(alone[:1], np.int64), np.full(len(alone[:1]), pole), np.inf)

    def _grow(self, size: int) -> bool:
        """Add up to `size` terms, prune after each success; False if PATIENCE of them have not lowered the cost."""
        model, stale = self.current, 0
        while len(model.chosen) < size:
            if stale > PATIENCE or self._must_end():
                return False
            grown = self._add_best_candidate(model, np.inf)
            if grown is None:
                return False
            model, stale = grown, stale + 1
            if grown.cost < self.current.cost * (1.0 - ChoiceLimits.MIN_TERM_GAIN):
                self._keep(grown)
                self._prune()
                model, stale = self.current, 0
        return True

    def _exchange_term(self) -> bool:
        """Replace a weak term by a candidate; return False if that does not lower the cost."""
        for place in self._find_weakest():
            less = self._remove_term(place)
            better = (
                self._add_best_candidate(less, self.current.cost * (1.0 - ChoiceLimits.MIN_TERM_GAIN)) if less else None
            )
            if better is not None:
                self._keep(better)
                return True
        return False

    def _prune(self) -> None:
        """Remove terms that are hardly a loss."""
        while len(self.current.chosen) > 1:
            for place in self._find_weakest():
                less = self._remove_term(place)
                if less is not None and less.cost < self.current.cost * (1.0 + ChoiceLimits.MAX_TERM_LOSS):
                    self._keep(less)
                    break
            else:
                return

    def _add_best_candidate(self, model: SearchResult, bound: float) -> SearchResult | None:
        """Return the best fit with one more term whose cost is below `bound`, None if there is none."""
        grown = []
        for chosen, coefficients in self._rank_candidates(model):
            if self._must_end():
                return None
            self.trials += 1
            grown.append((chosen, self._fit(chosen, coefficients, STEPS)))
        for chosen, fit in sorted(grown, key=lambda pair: pair[1].error):
            trial = self._evaluate(chosen, fit)
            if trial.cost < bound:
                return trial
        return None

    def _fit(self, chosen: I, coefficients: F, steps: int = 0) -> FreeRunFit:
        return fit_free_run(self.problem, chosen, coefficients, self.problem.estimation, steps)

    def _evaluate(self, chosen: I, fit: FreeRunFit) -> SearchResult:
        good = np.isfinite(fit.error) and self.problem.gain(chosen, fit.coefficients) < self.problem.max_gain
        cost = self.problem.selection_cost(chosen, fit.coefficients) if good else np.inf
        return self._result(chosen, fit.coefficients, cost)

    def _find_weakest(self) -> list[int]:
        """Return the places of the terms whose removal costs least, to second order."""
        model = self.current
        fit = self._fit(model.chosen, model.coefficients)
        if not np.isfinite(fit.error) or len(model.chosen) < 2:
            return []
        loss = fit.coefficients**2 / np.diag(_inverse(fit.matrix))
        return [int(place) for place in np.argsort(loss)[:WEAKEST]]

    def _remove_term(self, place: int) -> SearchResult | None:
        """Return the current model without the term at `place`, the others refitted; None if that is not stable."""
        model = self.current
        fit = self._fit(model.chosen, model.coefficients)
        column = _inverse(fit.matrix)[:, place]
        target = model.coefficients - column * (model.coefficients[place] / column[place])
        chosen, start = np.delete(model.chosen, place), np.delete(model.coefficients, place)
        step = np.delete(target, place) - start
        for share in STEP_SHARES:  # the largest that keeps the model stable and bounded
            fit = self._fit(chosen, start + share * step)
            if np.isfinite(fit.error):
                self.trials += 1
                return self._evaluate(chosen, self._fit(chosen, fit.coefficients, STEPS))
        return None

    def _rank_candidates(self, model: SearchResult) -> list[tuple[I, F]]:
        """Return the models with one more term, its coefficient 0, of greatest first-order gain, best first."""
        p = self.problem
        tried = np.setdiff1d(np.arange(len(p.candidates)), model.chosen)
        tried = tried[self.start.random.random(len(tried)) < (1.0 if self.start.seed == self.limits.seed else PART)]
        if not len(tried):
            return []
        terms, arrays = p.layout.subset(model.chosen), p.layout.arrays
        lags = np.unique(terms.outputs[terms.outputs > 0])
        force, _ = kernels.free_run(p.powers, p.segments, terms, model.coefficients, p.force_envelope)
        gains = output_gains(p.powers, p.segments, terms, model.coefficients, lags)
        run, error = (p.powers, p.segments, force, arrays), p.measured - force
        products = candidate_products(*run, model.chosen, tried, gains, lags, self._sampled_weights, error)
        matrix, gradient, cross, own = products
        inverse = _inverse(matrix)
        moved = cross @ inverse
        rest_of_own = own[:, 0] - (moved * cross).sum(axis=1)
        rest_of_error = own[:, 1] - moved @ gradient
        independent = rest_of_own > DEPENDENT * own[:, 0]
        gain = np.where(independent, rest_of_error**2 / np.where(independent, rest_of_own, 1.0), 0.0)
        best = [i for i in np.argsort(-gain)[:FITS_PER_STEP] if gain[i] > 0.0]
        return [(np.append(model.chosen, tried[i]), np.append(model.coefficients, 0.0)) for i in best]


def _inverse(matrix: F) -> F:
    """Return the inverse of a Gauss-Newton matrix, scaled and slightly regularised."""
    if not len(matrix):
        return np.zeros((0, 0))
    diagonal = np.diag(matrix)
    scale = 1.0 / np.sqrt(np.maximum(diagonal, 1e-12 * float(diagonal.max()) or 1.0))
    inverse = np.linalg.inv(matrix * scale[:, None] * scale + 1e-10 * np.eye(len(matrix)))
    return np.asarray(inverse * scale[:, None] * scale)


class ThesisSearch(TermSearch):
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
        order = self.start.random.permutation(
            np.setdiff1d(np.arange(len(self.problem.candidates)), self.problem.initial)
        )
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
        return SearchResult(chosen, coefficients, cost, self.start.seed, 1, RUNNING)

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
        places = self.start.random.permutation(len(model.chosen))
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
            p.gram, chosen, trial, p.run, p.layout.arrays, bound, RIDGE, drop
        )
        self.trials += len(trial) if place < 0 else place + 1
        return int(place), float(cost), coefficients


def search(problem: Problem, limits: Limits, listener: Listener = lambda result: None) -> list[SearchResult]:
    """Run the starts in parallel threads; return their results, best first.

    Ctrl-C stops every start and returns the best so far, or raises KeyboardInterrupt if there is none. `listener`
    receives each improvement and each start's result, from the threads.
    """
    limits = spread_work(limits, len(problem.measured))
    kind = ThesisSearch if limits.method == THESIS else GaussNewtonSearch
    return run_starts(limits, listener, lambda start: kind(problem, start).run())
