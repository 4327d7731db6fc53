"""Neuro-fuzzy models in a simulation-error fit: starts by hybrid learning, errors with their derivatives, the gain.

A start follows Jang (1993): memberships on a grid; then, in turn, consequents by least squares with measured past
forces and a descent of the premises on the same one-step error. The free-run fit that follows moves all parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product

import numpy as np

from ces_identify.numerics.arrays import F, I
from ces_identify.numerics.levenberg import Evaluate, damped_step
from ces_identify.trained.family import Family
from ces_identify.trained.fuzzy_kernels import FuzzyArrays
from ces_identify.trained.lagged_kernels import RegressorTable
from ces_identify.trained.lagged_table import delay_values, unscaled_inputs
from ces_identify.trained.training import SIGNALS
from ces_observer.structures.fuzzy import Bell, Fuzzy, Premise, Rule

FIRST_GAIN = 0.95  # largest gain of the past forces in a start
FIRST_SLOPE = 2.0
MIN_SLOPE, MAX_SLOPE = 0.6, 8.0  # of a membership
STIFFNESS = 1e-4  # [(J / 100)^2] cost of moving a membership by its own width
HYBRID_STEPS = 5
HYBRID_DAMPING = 1.0
QUANTILES = (0.002, 0.998)  # of a premise: the ends of the grid
START_JITTER = 0.15  # standard deviation of a start's centres, in distances between neighbours


@dataclass(frozen=True)
class PremiseGrid:
    """A premise: an input, its lag [ticks], and the number of memberships over its range."""

    signal: str
    lag: int
    memberships: int


@dataclass(frozen=True)
class FuzzyFit(Family):
    """Models on a `grid` of memberships; `decay` is the cost of a squared consequent in (J / 100)^2."""

    grid: tuple[PremiseGrid, ...]
    decay: float

    @property
    def size(self) -> int:
        """Number of rules."""
        return len(self.rules)

    @cached_property
    def owner(self) -> I:
        """The premise of each membership."""
        return np.repeat(np.arange(len(self.grid)), [g.memberships for g in self.grid])

    @cached_property
    def rules(self) -> I:
        """The membership that each rule uses of each premise: all combinations."""
        first = np.cumsum([0, *(g.memberships for g in self.grid)])
        return np.array(list(product(*(range(a, b) for a, b in pairwise(first)))), np.int64)

    @cached_property
    def premises(self) -> F:
        """The premises (ticks, premises) over the training ticks, in SI units."""
        t = self.training
        return unscaled_inputs([(g.signal, g.lag) for g in self.grid], t.envelope, t.inputs, t.segments)

    def parts(self, params: F) -> tuple[F, F]:
        """Return consequents (rules, 1 + R) and bells (memberships, 3)."""
        n = len(self.rules) * (1 + len(self.regressors))
        return params[:n].reshape(len(self.rules), -1), params[n:].reshape(-1, 3)

    @cached_property
    def grid_bells(self) -> F:
        """Centre, log width and log slope (memberships, 3) of an even grid over the range of each premise."""
        bells = []
        for g in self.grid:
            low, high = np.quantile(self.training.inputs[SIGNALS.index(g.signal)], QUANTILES)
            half = 0.5 * max(high - low, 1e-6) / max(1, g.memberships - 1)
            bells += [[c, np.log(half), np.log(FIRST_SLOPE)] for c in np.linspace(low, high, g.memberships)]
        return np.array(bells)

    def start(self, random: np.random.Generator) -> F:
        """Return parameters after hybrid learning from a randomly shifted grid."""
        bells = self.grid_bells.copy()
        bells[:, 0] += 2.0 * np.exp(bells[:, 1]) * random.normal(0.0, START_JITTER, len(bells))
        n = len(self.rules) * (1 + len(self.regressors))
        params = learn_hybrid(self._one_step_ahead(), np.concatenate([np.zeros(n), bells.ravel()]), n)
        past = self.parts(params)[0][:, 1 + self.past]
        past *= np.minimum(1.0, FIRST_GAIN / np.maximum(np.abs(past).sum(axis=1, keepdims=True), 1e-9))
        self.parts(params)[0][:, 1 + self.past] = past
        return params

    def _one_step_ahead(self) -> Evaluate:
        """Return the function of errors in which measured past forces replace the model's own."""
        t, table = self.training, self.table
        values = table.values.copy()
        for j in self.past:
            past = delay_values(t.measured, int(table.past_lags[j]), t.segments)
            values[:, j] = (past - table.past_means[j]) / table.past_spreads[j]
        measured = table._replace(values=values, past_lags=np.zeros_like(table.past_lags))
        return lambda params, max_error: self.errors_on(measured, params, max_error)

    def errors_on(self, table: RegressorTable, params: F, max_error: float) -> tuple[float, F, F]:
        """Return the squared error with regularisation, its matrix and its gradient; infinite for extreme slopes."""
        slopes = np.exp(self.parts(params)[1][:, 2])
        if slopes.min() < MIN_SLOPE or slopes.max() > MAX_SLOPE:
            return np.inf, np.empty(0), np.empty(0)
        error, matrix, gradient = self.normal_equations(table, params, max_error)
        cost, offsets = self._regularisation(params)
        matrix[np.diag_indices_from(matrix)] += cost
        return error + float(cost @ offsets**2), matrix, gradient - cost * offsets

    def _regularisation(self, params: F) -> tuple[F, F]:
        """Return the cost of each squared offset, and the offsets: consequents from 0, memberships from the grid."""
        consequents, bells = self.parts(params)
        stiffness = np.full(bells.shape, STIFFNESS)
        stiffness[:, 0] /= np.exp(2.0 * self.grid_bells[:, 1])
        cost = np.concatenate([np.full(consequents.size, self.decay), stiffness.ravel()])
        return cost, np.concatenate([consequents.ravel(), (bells - self.grid_bells).ravel()])

    def kernel_arrays(self, params: F) -> FuzzyArrays:
        """Return the arrays of the kernels."""
        return FuzzyArrays(self.training.scale_N, self.premises, self.owner, self.rules, *self.parts(params))

    def gains(self, params: F) -> tuple[F, F]:
        """Return each rule's gain of the past forces (rules,) and its gradient (rules, parameters)."""
        consequents, _ = self.parts(params)
        past = consequents[:, 1 + self.past]
        slope = np.zeros((len(self.rules), len(params)))
        for r in range(len(self.rules)):
            slope[r, r * consequents.shape[1] + 1 + self.past] = np.sign(past[r])
        return np.abs(past).sum(axis=1), slope

    def body(self, params: F) -> Fuzzy:
        """Return the neuro-fuzzy rules with these parameters."""
        consequents, bells = self.parts(params)
        fitted = [Bell(float(c), float(np.exp(w)), float(np.exp(s))) for c, w, s in bells]
        first = np.cumsum([0, *(g.memberships for g in self.grid)])
        premises = tuple(
            Premise(g.signal, g.lag, tuple(fitted[a : a + g.memberships]))
            for g, a in zip(self.grid, first, strict=False)
        )
        rules = tuple(
            Rule(tuple((members - first[:-1]).tolist()), float(row[0]), tuple(row[1:].tolist()))
            for members, row in zip(self.rules, consequents, strict=True)
        )
        return Fuzzy(self.regressors, self.training.scale_N, premises, rules)


def learn_hybrid(errors: Evaluate, params: F, consequents: int) -> F:
    """Return parameters after hybrid learning (Jang 1993).

    Each pass fits the first `consequents` parameters by least squares, then moves the premises if that lowers the
    error.
    """
    for _ in range(HYBRID_STEPS):
        _, matrix, gradient = errors(params, np.inf)
        params = params.copy()
        params[:consequents] += damped_step(matrix[:consequents, :consequents], gradient[:consequents], 0.0)
        error, matrix, gradient = errors(params, np.inf)
        trial = params.copy()
        trial[consequents:] += damped_step(matrix[consequents:, consequents:], gradient[consequents:], HYBRID_DAMPING)
        params = trial if errors(trial, error)[0] < error else params
    return params
