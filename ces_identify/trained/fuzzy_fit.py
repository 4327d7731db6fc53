"""A neuro-fuzzy model as a simulation-error fit sees it: starts by hybrid learning, errors with derivatives, gain.

A start follows Jang (1993): memberships spread over a grid, consequents by least squares on measured past forces,
premises by steps down that equation error, in turn. The free-run fit that follows moves all of them together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product

import numpy as np

from ces_identify.numerics.arrays import F, I
from ces_identify.numerics.levenberg import Evaluate, damped_step
from ces_identify.trained.fuzzy_kernels import FuzzyArrays
from ces_identify.trained.lagged_kernels import RegressorTable, lagged_free_run, lagged_normal_equations
from ces_identify.trained.lagged_table import delay_values, regressor_table
from ces_identify.trained.training import SIGNALS, Training
from ces_observer.model import Model, Sampling
from ces_observer.structures.fuzzy import Bell, Fuzzy, Premise, Rule
from ces_observer.structures.lagged_signals import Regressor

FIRST_GAIN = 0.95  # most that past forces count for in a start
FIRST_SLOPE = 2.0
MIN_SLOPE, MAX_SLOPE = 0.6, 8.0  # of a membership
STIFFNESS = 1e-4  # [(J / 100)^2] price of a membership's move by its own size
HYBRID_STEPS = 5
HYBRID_DAMPING = 1.0
QUANTILES = (0.002, 0.998)  # of a premise, between which the grid lies
START_JITTER = 0.15  # spread of a start's centres, in distances between neighbours


@dataclass(frozen=True)
class PremiseGrid:
    """A premise of the grid: an input, its lag [ticks], and how many memberships are spread over its range."""

    signal: str
    lag: int
    memberships: int


@dataclass(frozen=True)
class FuzzyFit:
    """Neuro-fuzzy models over a `grid` of memberships on `regressors`, as parameter vectors (see fuzzy_kernels).

    `decay` is the price of a squared consequent, in (J / 100)^2.
    """

    training: Training
    regressors: tuple[Regressor, ...]
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
        """Each rule's membership of each premise: every combination."""
        first = np.cumsum([0, *(g.memberships for g in self.grid)])
        return np.array(list(product(*(range(a, b) for a, b in pairwise(first)))), np.int64)

    @cached_property
    def table(self) -> RegressorTable:
        """The regressors over the training ticks."""
        t = self.training
        return regressor_table(self.regressors, t.envelope, t.inputs, t.segments)

    @cached_property
    def premises(self) -> F:
        """The premises (ticks, premises) over the training ticks, in their units."""
        t = self.training
        raw = [Regressor(g.signal, g.lag, 0.0, 1.0) for g in self.grid]
        return regressor_table(raw, t.envelope, t.inputs, t.segments).values

    @cached_property
    def past(self) -> I:
        """Indices of the regressors that are past forces."""
        return np.flatnonzero(self.table.past_lags)

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
        """Return parameters after hybrid learning from a grid of memberships, a little moved."""
        bells = self.grid_bells.copy()
        bells[:, 0] += 2.0 * np.exp(bells[:, 1]) * random.normal(0.0, START_JITTER, len(bells))
        n = len(self.rules) * (1 + len(self.regressors))
        params = learn_hybrid(self._one_step_ahead(), np.concatenate([np.zeros(n), bells.ravel()]), n)
        past = self.parts(params)[0][:, 1 + self.past]
        past *= np.minimum(1.0, FIRST_GAIN / np.maximum(np.abs(past).sum(axis=1, keepdims=True), 1e-9))
        self.parts(params)[0][:, 1 + self.past] = past
        return params

    def _one_step_ahead(self) -> Evaluate:
        """Return the errors with measured past forces in place of the model's own, as least squares sees them."""
        t, table = self.training, self.table
        values = table.values.copy()
        for j in self.past:
            past = delay_values(t.measured, int(table.past_lags[j]), t.segments)
            values[:, j] = (past - table.past_means[j]) / table.past_spreads[j]
        known = table._replace(values=values, past_lags=np.zeros_like(table.past_lags))
        return lambda params, most: self.errors_on(known, params, most)

    def errors(self, params: F, max_error: float) -> tuple[float, F, F]:
        """Return the squared error on the estimation ticks with all prices, its matrix and its gradient."""
        return self.errors_on(self.table, params, max_error)

    def errors_on(self, table: RegressorTable, params: F, most: float) -> tuple[float, F, F]:
        """Return the errors on these regressors."""
        t = self.training
        slopes = np.exp(self.parts(params)[1][:, 2])
        if slopes.min() < MIN_SLOPE or slopes.max() > MAX_SLOPE:
            return np.inf, np.empty(0), np.empty(0)
        error, matrix, gradient = lagged_normal_equations(
            table, t.segments, self._arrays(params), *t.loose, t.measured, t.estimation, most
        )
        price, moved = self._prices(params)
        matrix[np.diag_indices_from(matrix)] += price
        return error + float(price @ moved**2), matrix, gradient - price * moved

    def _prices(self, params: F) -> tuple[F, F]:
        """Return the price of each squared parameter, and the parameters, memberships as moves from the grid."""
        consequents, bells = self.parts(params)
        stiffness = np.full(bells.shape, STIFFNESS)
        stiffness[:, 0] /= np.exp(2.0 * self.grid_bells[:, 1])
        price = np.concatenate([np.full(consequents.size, self.decay), stiffness.ravel()])
        return price, np.concatenate([consequents.ravel(), (bells - self.grid_bells).ravel()])

    def force(self, params: F) -> F:
        """Return the free run [N] over the training ticks, NaN where it left the force envelope."""
        t = self.training
        force, _ = lagged_free_run(self.table, t.segments, self._arrays(params), *t.force_envelope)
        return np.asarray(force)

    def _arrays(self, params: F) -> FuzzyArrays:
        return FuzzyArrays(self.training.scale_N, self.premises, self.owner, self.rules, *self.parts(params))

    def gains(self, params: F) -> tuple[F, F]:
        """Return each rule's gain of past forces (rules,) and its gradient (rules, parameters)."""
        consequents, _ = self.parts(params)
        past = consequents[:, 1 + self.past]
        slope = np.zeros((len(self.rules), len(params)))
        for r in range(len(self.rules)):
            slope[r, r * consequents.shape[1] + 1 + self.past] = np.sign(past[r])
        return np.abs(past).sum(axis=1), slope

    def model(self, params: F, sampling: Sampling) -> Model:
        """Return the model of these parameters."""
        t = self.training
        return Model(sampling, self._fuzzy(params), t.envelope, t.force_envelope)

    def _fuzzy(self, params: F) -> Fuzzy:
        consequents, bells = self.parts(params)
        made = [Bell(float(c), float(np.exp(w)), float(np.exp(s))) for c, w, s in bells]
        first = np.cumsum([0, *(g.memberships for g in self.grid)])
        premises = tuple(
            Premise(g.signal, g.lag, tuple(made[a : a + g.memberships])) for g, a in zip(self.grid, first, strict=False)
        )
        rules = tuple(
            Rule(tuple((members - first[:-1]).tolist()), float(row[0]), tuple(row[1:].tolist()))
            for members, row in zip(self.rules, consequents, strict=True)
        )
        return Fuzzy(self.regressors, self.training.scale_N, premises, rules)


def learn_hybrid(errors: Evaluate, params: F, consequents: int) -> F:
    """Return parameters after passes of hybrid learning (Jang 1993): consequents (the first ones) by least squares,
    then a step of the premises down the same error, kept if it lowers it."""
    for _ in range(HYBRID_STEPS):
        _, matrix, gradient = errors(params, np.inf)
        params = params.copy()
        params[:consequents] += damped_step(matrix[:consequents, :consequents], gradient[:consequents], 0.0)
        error, matrix, gradient = errors(params, np.inf)
        trial = params.copy()
        trial[consequents:] += damped_step(matrix[consequents:, consequents:], gradient[consequents:], HYBRID_DAMPING)
        params = trial if errors(trial, error)[0] < error else params
    return params
