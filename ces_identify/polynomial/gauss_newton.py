"""Forward selection by Gauss-Newton gain on the free-run error, with pruning and exchange, from seeded starts.

The sensitivity of each candidate predicts, to first order, how much the free-run error on the estimation ticks falls
if the candidate is added and all coefficients are adjusted. The most promising candidates are fitted by
Levenberg-Marquardt and the best fit is added; the model with the lowest free-run cost on the selection ticks is kept.
Terms that are no longer needed are pruned; at the end weak terms are exchanged. Each start but the first considers a
random part of the candidates at each step.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ces_data.arrays import F, I
from ces_identify.numerics import kernels
from ces_identify.polynomial.free_run_fit import FreeRunFit, fit_free_run
from ces_identify.polynomial.search_limits import SearchResult, SearchStart
from ces_identify.polynomial.sensitivity_kernels import candidate_products, output_gains

MIN_GAIN = 0.001  # relative gain required of a new term
PRUNE_LOSS = 0.0005  # relative loss below which a term is pruned
FITS_PER_STEP = 4  # candidates fitted at a step
PATIENCE = 3  # terms added without success before growth stops
WEAKEST = 3  # terms tried for pruning or exchange
PART = 0.6  # share of the candidates considered at a step, except in the first start
POLES = (0.9, 0.7, 0.97, 0.5)  # of the first models of successive starts
STEPS = 4  # of Levenberg-Marquardt per trial
THINNING = 3  # gains are estimated on every third tick, or on fewer if more than MAX_SAMPLED_TICKS remain
MAX_SAMPLED_TICKS = 30_000
DEPENDENT = 1e-6  # least share of a candidate's sensitivity that the model's terms do not span
STEP_SHARES = (1.0, 0.5, 0.2, 0.05)  # shares of a Gauss-Newton step tried


class GaussNewtonStart(SearchStart):
    """One start; its current model is the best so far."""

    @cached_property
    def _sampled_weights(self) -> F:
        """The weights of the ticks on which gains are estimated, 0 elsewhere."""
        weights = self.problem.estimation
        ticks = np.flatnonzero(weights)
        sampled = np.zeros_like(weights)
        sampled[ticks[:: max(THINNING, -(-len(ticks) // MAX_SAMPLED_TICKS))]] = 1.0
        return sampled * weights

    def _search(self) -> None:
        """Grow, prune and exchange until nothing helps, the target is reached, time is up or it is interrupted."""
        self._grow()
        while self.limits.exchanges and self._exchange_term():
            self._prune()

    def _first_model(self) -> SearchResult:
        """Return the model of a past force alone; candidates are then compared behind a first-order lag."""
        terms = self.problem.candidates
        alone = [i for i, term in enumerate(terms) if term.output_lag == 1 and not term.inputs]
        pole = POLES[(self.seed - self.limits.seed) % len(POLES)]
        return self._result(np.array(alone[:1], np.int64), np.full(len(alone[:1]), pole), np.inf)

    def _grow(self) -> None:
        """Add terms until PATIENCE of them have not lowered the cost; prune after each success."""
        model, stale = self.current, 0
        while len(model.chosen) < self.limits.term_limit and stale <= PATIENCE and not self._reason_to_end():
            grown = self._add_best_candidate(model, np.inf)
            if grown is None:
                return
            model, stale = grown, stale + 1
            if grown.cost < self.current.cost * (1.0 - MIN_GAIN):
                self._keep(grown)
                self._prune()
                model, stale = self.current, 0

    def _exchange_term(self) -> bool:
        """Replace a weak term by a candidate; return False if that does not lower the cost."""
        for place in self._find_weakest():
            less = self._remove_term(place)
            better = self._add_best_candidate(less, self.current.cost * (1.0 - MIN_GAIN)) if less else None
            if better is not None:
                self._keep(better)
                return True
        return False

    def _prune(self) -> None:
        """Remove terms whose loss is below PRUNE_LOSS."""
        while len(self.current.chosen) > 1:
            for place in self._find_weakest():
                less = self._remove_term(place)
                if less is not None and less.cost < self.current.cost * (1.0 + PRUNE_LOSS):
                    self._keep(less)
                    break
            else:
                return

    def _add_best_candidate(self, model: SearchResult, bound: float) -> SearchResult | None:
        """Return the best fit with one more term whose cost is below `bound`, None if there is none."""
        grown = []
        for chosen, coefficients in self._rank_candidates(model):
            if self._reason_to_end():
                return None
            self.trials += 1
            grown.append((chosen, self._fit(chosen, coefficients, STEPS)))
        for chosen, fit in sorted(grown, key=lambda one: one[1].error):
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
        rest = np.setdiff1d(np.arange(len(p.candidates)), model.chosen)
        rest = rest[self.random.random(len(rest)) < (1.0 if self.seed == self.limits.seed else PART)]
        if not len(rest):
            return []
        terms, arrays = p.compiled.subset(model.chosen), p.compiled.arrays
        lags = np.unique(terms.outputs[terms.outputs > 0])
        force, _ = kernels.free_run(p.powers, p.segments, terms, model.coefficients, p.force_envelope)
        gains = output_gains(p.powers, p.segments, terms, model.coefficients, lags)
        run, error = (p.powers, p.segments, force, arrays), p.measured - force
        products = candidate_products(*run, model.chosen, rest, gains, lags, self._sampled_weights, error)
        matrix, gradient, cross, own = products
        inverse = _inverse(matrix)
        moved = cross @ inverse
        rest_of_own = own[:, 0] - (moved * cross).sum(axis=1)
        rest_of_error = own[:, 1] - moved @ gradient
        independent = rest_of_own > DEPENDENT * own[:, 0]
        gain = np.where(independent, rest_of_error**2 / np.where(independent, rest_of_own, 1.0), 0.0)
        best = [i for i in np.argsort(-gain)[:FITS_PER_STEP] if gain[i] > 0.0]
        return [(np.append(model.chosen, rest[i]), np.append(model.coefficients, 0.0)) for i in best]


def _inverse(matrix: F) -> F:
    """Return the inverse of a Gauss-Newton matrix, scaled and slightly regularised."""
    if not len(matrix):
        return np.zeros((0, 0))
    diagonal = np.diag(matrix)
    scale = 1.0 / np.sqrt(np.maximum(diagonal, 1e-12 * float(diagonal.max()) or 1.0))
    inverse = np.linalg.inv(matrix * scale[:, None] * scale + 1e-10 * np.eye(len(matrix)))
    return np.asarray(inverse * scale[:, None] * scale)
