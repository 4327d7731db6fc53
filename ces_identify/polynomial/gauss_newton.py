"""Gauss-Newton on the free-run error: the fit of a model's coefficients, and forward selection by predicted gain.

The fit is Levenberg-Marquardt with a penalty on the probed gain that keeps the model stable.

The selection grows a model with pruning and exchange, from seeded starts. The sensitivity of each candidate predicts,
to first order, how much the free-run error on the estimation ticks falls if the candidate is added and all coefficients
are adjusted. The most promising candidates are fitted and the best fit is added; the model with the lowest free-run
cost on the selection ticks is kept. Terms that are no longer needed are pruned; at the end weak terms are exchanged.
Each start but the first considers a random part of the candidates at each step.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ces_data.arrays import F, I
from ces_identify.numerics import kernels
from ces_identify.numerics.levenberg import damped_step
from ces_identify.polynomial.problem import Problem
from ces_identify.polynomial.search_limits import SearchResult, SearchStart
from ces_identify.polynomial.sensitivity_kernels import candidate_products, normal_equations, output_gains

ROOM = 0.005  # the penalty begins so far below the greatest gain allowed
PENALTY = 1e3  # of a squared excess of gain, in units of the squared error at the start
STOP_DECREASE = 2e-4  # relative decrease at which to stop
TRIES = 8  # dampings tried per step


@dataclass(frozen=True)
class FreeRunFit:
    """Coefficients (terms,), their weighted squared error (infinite if the run diverges) and Gauss-Newton matrix."""

    coefficients: F
    error: float
    matrix: F


def fit_free_run(problem: Problem, chosen: I, coefficients: F, weights: F, iterations: int) -> FreeRunFit:
    """Return the coefficients after at most `iterations` steps that lower the weighted free-run error.

    If the problem requires stable models and the first one is stable, so is every step; its probed gain may reach the
    mean of the greatest gain allowed and 1.
    """
    arrays, probes = problem.compiled.subset(chosen), problem.probes[chosen]

    def equations(c: F) -> tuple[float, F, F]:
        if kernels.probed_gain(probes, arrays.outputs, c) >= 0.5 * (1.0 + problem.max_gain):
            return np.inf, np.empty(0), np.empty(0)
        result: tuple[float, F, F] = normal_equations(
            problem.powers, problem.segments, weights, problem.measured, arrays, c, problem.force_envelope
        )
        return result

    error, matrix, gradient = equations(coefficients)
    if not np.isfinite(error):
        return FreeRunFit(coefficients, np.inf, matrix)
    hinge = _Hinge(probes, arrays.outputs, problem.max_gain - ROOM, PENALTY * error)
    value, damping = error + hinge.value(coefficients), 1e-4
    for _ in range(iterations):
        curvature, slope = hinge.derive(coefficients)
        for _ in range(TRIES):
            step = damped_step(matrix + curvature, gradient - slope, damping)
            e, h, g = equations(coefficients + step)
            trial = e + hinge.value(coefficients + step)
            if trial < value:
                break
            damping *= 8.0
        else:
            break
        coefficients, error, matrix, gradient = coefficients + step, e, h, g
        converged = value - trial < STOP_DECREASE * value
        value, damping = trial, max(damping / 8.0, 1e-9)
        if converged:
            break
    return FreeRunFit(coefficients, error, matrix)


class _Hinge:
    """Penalty on the probed gain above a limit: strength * sum max(0, gain - limit)^2 over the points."""

    def __init__(self, probes: F, outputs: I, limit: float, strength: float) -> None:
        self.limit, self.strength = limit, strength
        lags = np.unique(outputs[outputs > 0]) if np.isfinite(limit) else np.empty(0, np.int64)
        self.groups = [np.where((outputs == lag)[:, None], probes, 0.0) for lag in lags]

    def value(self, coefficients: F) -> float:
        """Return the penalty."""
        return self.strength * float((self._excess(coefficients) ** 2).sum())

    def derive(self, coefficients: F) -> tuple[F, F]:
        """Return the penalty's Gauss-Newton matrix (terms, terms) and half its gradient (terms,)."""
        n = len(coefficients)
        excess = self._excess(coefficients)
        active = excess > 0.0
        if not active.any():
            return np.zeros((n, n)), np.zeros(n)
        slopes = np.zeros((n, int(active.sum())))
        for group in self.groups:
            slopes += group[:, active] * np.sign(coefficients @ group[:, active])
        return self.strength * slopes @ slopes.T, self.strength * slopes @ excess[active]

    def _excess(self, coefficients: F) -> F:
        if not self.groups:
            return np.zeros(1)
        gain = sum(np.abs(coefficients @ group) for group in self.groups)
        return np.maximum(gain - self.limit, 0.0)


ITERATIONS = 20  # of the last fit, to all ticks


def refit_coefficients(problem: Problem, result: SearchResult) -> F:
    """Return coefficients fitted to all identification ticks, those of `result` if that raises the selection cost."""
    fit = fit_free_run(problem, result.chosen, result.coefficients, problem.everything, ITERATIONS)
    harmless = np.isfinite(fit.error) and problem.selection_cost(result.chosen, fit.coefficients) <= result.cost
    return fit.coefficients if harmless else result.coefficients


MIN_GAIN = 0.001  # relative gain required of a new term
PRUNE_LOSS = 0.0005  # relative loss below which a term is pruned
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


class GaussNewtonStart(SearchStart):
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
        """Return the model of a past force alone; candidates are then compared behind a first-order lag."""
        terms = self.problem.candidates
        alone = [i for i, term in enumerate(terms) if term.output_lag == 1 and not term.inputs]
        pole = POLES[(self.seed - self.limits.seed) % len(POLES)]
        return self._result(np.array(alone[:1], np.int64), np.full(len(alone[:1]), pole), np.inf)

    def _grow(self, size: int) -> bool:
        """Add up to `size` terms, prune after each success; False if PATIENCE of them have not lowered the cost."""
        model, stale = self.current, 0
        while len(model.chosen) < size:
            if stale > PATIENCE or self._reason_to_end():
                return False
            grown = self._add_best_candidate(model, np.inf)
            if grown is None:
                return False
            model, stale = grown, stale + 1
            if grown.cost < self.current.cost * (1.0 - MIN_GAIN):
                self._keep(grown)
                self._prune()
                model, stale = self.current, 0
        return True

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
