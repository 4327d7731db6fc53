"""Forward selection by Gauss-Newton gain on the free-run error, with pruning and exchange, from seeded starts.

For the model so far, every candidate's sensitivity tells to first order how far the free-run error on the estimation
ticks would fall if it were added and all coefficients moved with it. The most promising are fitted by
Levenberg-Marquardt and the one that fits best is added; the model of least free-run cost on the selection ticks is
kept. Terms that are no longer needed are pruned; at the end weak terms are exchanged. Each start but the first sees a
random part of the candidates at each step.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ces_identify.numerics import kernels
from ces_identify.polynomial.free_run_fit import FreeRunFit, fit_free_run
from ces_identify.polynomial.limits import SearchResult
from ces_identify.polynomial.search_start import SearchStart
from ces_identify.polynomial.sensitivity_kernels import candidate_products, output_gains

F = NDArray[np.float64]
I = NDArray[np.int64]  # noqa: E741

MIN_GAIN = 0.001  # relative gain asked of a new term
PRUNE_LOSS = 0.0005  # relative loss at which a term is no longer worth keeping
FITS_PER_STEP = 4  # candidates fitted at a step
PATIENCE = 3  # terms added in vain before a start gives up
WEAKEST = 3  # terms tried for pruning or exchange
PART = 0.6  # of the candidates seen at a step, but for the first start
POLES = (0.9, 0.7, 0.97, 0.5)  # of a start from nothing, in turn
STEPS = 4  # of Levenberg-Marquardt for a trial
THINNING = 3  # every so many ticks tell the gains, or more where that leaves more than
MAX_SAMPLED_TICKS = 30_000  # ticks
DEPENDENT = 1e-6  # share of a candidate's sensitivity that must be its own
STEP_SHARES = (1.0, 0.5, 0.2, 0.05)  # shares of a Gauss-Newton step tried


class GaussNewtonStart(SearchStart):
    """One start, from nothing or from the model `begin`: `run` returns the best model found."""

    @property
    def part(self) -> float:
        """The share of the candidates seen at a step."""
        return 1.0 if self.seed == self.limits.seed else PART

    @cached_property
    def weights(self) -> F:
        """The weights of the estimation ticks, 0 elsewhere."""
        return np.where(self.problem.selection > 0.0, 0.0, self.problem.everything)

    @cached_property
    def sampled(self) -> F:
        """Those weights on the few ticks that tell the gains, 0 elsewhere."""
        sampled = np.zeros_like(self.weights)
        sampled[np.flatnonzero(self.weights)[:: _thinning(self.weights)]] = 1.0
        return sampled * self.weights

    def run(self) -> SearchResult:
        """Grow, prune and exchange until nothing helps, the target is reached, time is up or it is interrupted."""
        self._grow()
        while self.limits.exchanges and self._exchange_term():
            self._prune()
        ended = self._reason_to_end() or "candidates exhausted"
        self._keep(replace(self.best, trials=self.trials, ended=ended))
        return self.best

    def _first_model(self) -> SearchResult:
        """Return the model that only fades, a past force alone: every candidate's gain is then told behind a lag."""
        terms = self.problem.candidates
        alone = [i for i, term in enumerate(terms) if term.output_lag == 1 and not term.inputs]
        pole = POLES[(self.seed - self.limits.seed) % len(POLES)]
        chosen, coefficients = np.array(alone[:1], np.int64), np.full(len(alone[:1]), pole)
        return SearchResult(chosen, coefficients, np.inf, self.seed, 0, "running")

    def _keep(self, found: SearchResult) -> None:
        self.best = found
        self.listener(found)

    def _grow(self) -> None:
        """Add terms for as long as one in a few of them lowers the cost; take out what is no longer needed."""
        model, stale = self.best, 0
        while len(model.chosen) < self.limits.max_terms and stale <= PATIENCE and not self._reason_to_end():
            grown = self._add_best_candidate(model, np.inf)
            if grown is None:
                return
            model, stale = grown, stale + 1
            if grown.cost < self.best.cost * (1.0 - MIN_GAIN):
                self._keep(grown)
                self._prune()
                model, stale = self.best, 0

    def _exchange_term(self) -> bool:
        """Put a candidate in the place of a weak term, if that helps."""
        for place in self._find_weakest(self.best):
            less = self._remove_term(self.best, place)
            better = self._add_best_candidate(less, self.best.cost * (1.0 - MIN_GAIN)) if less else None
            if better is not None:
                self._keep(better)
                return True
        return False

    def _prune(self) -> None:
        """Take out terms whose loss is next to nothing."""
        while len(self.best.chosen) > 1:
            for place in self._find_weakest(self.best):
                less = self._remove_term(self.best, place)
                if less is not None and less.cost < self.best.cost * (1.0 + PRUNE_LOSS):
                    self._keep(less)
                    break
            else:
                return

    def _add_best_candidate(self, found: SearchResult, bound: float) -> SearchResult | None:
        """Return the model with the most promising candidate that fits best, if it brings the cost below `bound`."""
        grown = []
        for chosen, coefficients in self._rank_candidates(found):
            if self._reason_to_end():
                return None
            self.trials += 1
            grown.append((chosen, fit_free_run(self.problem, chosen, coefficients, self.weights, STEPS)))
        for chosen, fit in sorted(grown, key=lambda one: one[1].error):
            model = self._evaluate(chosen, fit)
            if model.cost < bound:
                return model
        return None

    def _fit(self, chosen: I, coefficients: F) -> SearchResult:
        self.trials += 1
        return self._evaluate(chosen, fit_free_run(self.problem, chosen, coefficients, self.weights, STEPS))

    def _evaluate(self, chosen: I, fit: FreeRunFit) -> SearchResult:
        good = np.isfinite(fit.error) and self.problem.gain(chosen, fit.coefficients) < self.problem.max_gain
        cost = self.problem.selection_cost(chosen, fit.coefficients) if good else np.inf
        return SearchResult(chosen, fit.coefficients, cost, self.seed, self.trials, "running")

    def _find_weakest(self, found: SearchResult) -> list[int]:
        """Return the places of the terms that the fit would miss least, to second order."""
        fit = fit_free_run(self.problem, found.chosen, found.coefficients, self.weights, 0)
        if not np.isfinite(fit.error) or len(found.chosen) < 2:
            return []
        loss = fit.coefficients**2 / np.diag(_inverse(fit.matrix))
        return [int(place) for place in np.argsort(loss)[:WEAKEST]]

    def _remove_term(self, found: SearchResult, place: int) -> SearchResult | None:
        """Return the model without the term at `place`, the others moved to make up for it."""
        fit = fit_free_run(self.problem, found.chosen, found.coefficients, self.weights, 0)
        column = _inverse(fit.matrix)[:, place]
        target = found.coefficients - column * (found.coefficients[place] / column[place])
        chosen, start = np.delete(found.chosen, place), np.delete(found.coefficients, place)
        coefficients = self._shorten_step(chosen, start, np.delete(target, place) - start)
        return None if coefficients is None else self._fit(chosen, coefficients)

    def _shorten_step(self, chosen: I, start: F, step: F) -> F | None:
        """Return `start` plus as much of `step` as keeps the model stable and bounded."""
        for share in STEP_SHARES:
            fit = fit_free_run(self.problem, chosen, start + share * step, self.weights, 0)
            if np.isfinite(fit.error):
                return fit.coefficients
        return None

    def _rank_candidates(self, found: SearchResult) -> list[tuple[I, F]]:
        """Return the models with one more term, as yet at 0, of greatest first-order gain, most first."""
        p = self.problem
        rest = np.setdiff1d(np.arange(len(p.candidates)), found.chosen)
        rest = rest[self.random.random(len(rest)) < self.part]
        if not len(rest):
            return []
        matrix, gradient, cross, own = self._products(found, rest)
        inverse = _inverse(matrix)
        moved = cross @ inverse
        rest_of_own = own[:, 0] - (moved * cross).sum(axis=1)
        rest_of_error = own[:, 1] - moved @ gradient
        independent = rest_of_own > DEPENDENT * own[:, 0]
        gain = np.where(independent, rest_of_error**2 / np.where(independent, rest_of_own, 1.0), 0.0)
        best = [i for i in np.argsort(-gain)[:FITS_PER_STEP] if gain[i] > 0.0]
        return [(np.append(found.chosen, rest[i]), np.append(found.coefficients, 0.0)) for i in best]

    def _products(self, found: SearchResult, rest: I) -> tuple[F, F, F, F]:
        p, c = self.problem, self.problem.compiled
        own = c.subset(found.chosen)
        lags = np.unique(own.outputs[own.outputs > 0])
        force, _ = kernels.free_run(p.powers, p.segments, *own.arrays, found.coefficients, *p.force_envelope)
        gains = output_gains(p.powers, p.segments, *own.arrays, found.coefficients, lags)
        products: tuple[F, F, F, F] = candidate_products(
            p.powers,
            p.segments,
            force,
            *c.arrays,
            found.chosen,
            rest,
            gains,
            lags,
            self.sampled,
            p.measured - force,
        )
        return products


def _thinning(weights: F) -> int:
    return max(THINNING, -(-int(np.count_nonzero(weights)) // MAX_SAMPLED_TICKS))


def _inverse(matrix: F) -> F:
    """Return the inverse of a Gauss-Newton matrix, scaled and a little regularised."""
    if not len(matrix):
        return np.zeros((0, 0))
    diagonal = np.diag(matrix)
    scale = 1.0 / np.sqrt(np.maximum(diagonal, 1e-12 * float(diagonal.max()) or 1.0))
    inverse = np.linalg.inv(matrix * scale[:, None] * scale + 1e-10 * np.eye(len(matrix)))
    return np.asarray(inverse * scale[:, None] * scale)
