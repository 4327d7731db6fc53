"""Training of gated experts: from a free past force into a bounded one, by Levenberg-Marquardt on the free run.

A descent under the final limit of the gains, from a random start, ends in poor places. So the limit begins above 1,
where a model need not forget, and comes down in steps; each descent goes on from the last one's parameters.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import ClassVar

import numpy as np

from ces_data.arrays import F
from ces_identify.numerics.levenberg import CentredProblem, descend_about_centre
from ces_identify.polynomial.search_limits import Limits, Listener, SearchResult, reason_to_end
from ces_identify.trained.experts_kernels import fill_experts_slopes
from ces_identify.trained.lagged_kernels import normal_equations
from ces_identify.trained.training import LaggedModels, Training
from ces_observer.structures.experts import Expert, Experts
from ces_observer.tick.experts import experts_force

EARLY_TICKS, LAST_TICKS = 8_000, 20_000  # that count before the last stage and in it, about
FIRST_LIMIT, STAGES = 1.1, 8  # of the gains; steps down to the final one (Keio: 8.2 %, 11.1 % straight)
STAGE_STEPS, LAST_STEPS, REFIT_STEPS = 12, 60, 6
PATIENCE, WORTHWHILE = 10, 1e-3  # steps without this relative fall of the selection cost, after which a descent ends
FIRST_GAIN, FIRST_ROOM = 0.9, 0.3  # of a start, towards which the fit is pulled
FIRST_ROWS = (1.0, 0.1, 0.5)  # standard deviations of gates, and of linear parts and bends over 1 - FIRST_GAIN
GAIN_PULL = 1e-5  # [(J / 100)^2] of a squared change of a gain's or room's parameter


@dataclass(frozen=True)
class ExpertsFit(LaggedModels):
    """`count` experts whose gains are from 0 to `limit`; `decay` is the cost of a squared weight in (J / 100)^2.

    The last regressor is the past force. Parameters (n,): the rows of gates, linear parts and bends, as in the tick,
    then for each expert the logits of both of its gains over `limit`, and the logarithm of its room.
    """

    count: int
    limit: float
    decay: float
    kernel: ClassVar = staticmethod(normal_equations(experts_force, fill_experts_slopes))

    @property
    def size(self) -> int:
        """Number of experts."""
        return self.count

    @property
    def rows(self) -> int:
        """Number of weights, with which `params` begins."""
        return 3 * self.count * len(self.regressors)

    @property
    def centre(self) -> F:
        """The parameters without effect of the inputs, and the usual gains and rooms."""
        share = FIRST_GAIN / self.limit
        usual = [np.log(share / (1.0 - share))] * 2 + [np.log(FIRST_ROOM)]
        return np.concatenate([np.zeros(self.rows), np.tile(usual, self.count)])

    def start(self, random: np.random.Generator) -> F:
        """Return random parameters: experts that differ in their inputs, with the mean force."""
        shape = self.count, len(self.regressors)
        rows = np.stack([random.normal(0.0, size / np.sqrt(shape[1]), shape) for size in FIRST_ROWS])
        rows[1:] *= 1.0 - FIRST_GAIN
        rows[1, :, -1] = (1.0 - FIRST_GAIN) * self.training.level
        params = self.centre
        params[: self.rows] = rows.ravel()
        params[self.rows :].reshape(-1, 3)[:, :2] += random.normal(0.0, 0.3, (self.count, 2))
        return params

    def split(self, params: F) -> tuple[F, F, F]:
        """Return the rows (3, experts, inputs + 1), both gains (experts, 2) and the room (experts,) of each expert."""
        own = params[self.rows :].reshape(-1, 3)
        rows = params[: self.rows].reshape(3, self.count, -1)
        return rows, self.limit / (1.0 + np.exp(-own[:, :2])), np.exp(own[:, 2])

    def body(self, params: F) -> Experts:
        """Return the experts with these parameters."""
        rows, gains, rooms = self.split(params)
        numbers = np.column_stack([gains[:, 0], gains[:, 1] - gains[:, 0], rooms])
        experts = tuple(
            Expert(tuple(gate), tuple(linear), tuple(bend), *own)
            for gate, linear, bend, own in zip(*rows.tolist(), numbers.tolist(), strict=True)
        )
        return Experts(self.regressors[:-1], self.regressors[-1], self.training.scale_N, experts)

    def problem(self) -> CentredProblem:
        """Return the free run's squared error on the estimation ticks, with the pulls."""
        pull = np.concatenate([np.full(self.rows, self.decay), np.full(3 * self.count, GAIN_PULL)])
        return CentredProblem(self._error, self._differentiate, pull, self.centre)

    def _error(self, params: F) -> float:
        t = self.training
        error = t.estimation @ (self.force(params, t.loose) - t.measured) ** 2
        return float(error) if np.isfinite(error) else np.inf

    def _differentiate(self, params: F) -> tuple[float, F, F]:
        """Return the error, its matrix and the gradient of half of it, from those by the numbers of the tick."""
        error, matrix, gradient = self.normal_equations(self.table, params, np.inf)
        if not np.isfinite(error):
            return error, matrix, gradient
        _, gains, rooms = self.split(params)
        slopes = gains * (1.0 - gains / self.limit)
        to = np.zeros((self.count, 3, 3))
        to[:, 0, 0], to[:, 1, 0], to[:, 1, 1], to[:, 2, 2] = slopes[:, 0], -slopes[:, 0], slopes[:, 1], rooms
        for at, own in zip(range(self.rows, len(params), 3), to, strict=True):
            part = slice(at, at + 3)
            gradient[part] = own.T @ gradient[part]
            matrix[:, part] = matrix[:, part] @ own
            matrix[part] = own.T @ matrix[part]
        return error, matrix, -gradient


def take_every(training: Training, every: int) -> Training:
    """Return the data in which only every `every`-th tick counts in a fit, as much as those between."""
    counted = np.arange(len(training.measured)) % max(1, every) == 0
    return replace(training, estimation=np.where(counted, max(1, every) * training.estimation, 0.0))


def descend_in_stages(family: ExpertsFit, params: F) -> Iterator[tuple[bool, F]]:
    """Yield whether it is the last stage, and the parameters, after each step from the first limit to the last."""
    early, late = (
        replace(family, training=take_every(family.training, len(family.training.measured) // ticks))
        for ticks in (EARLY_TICKS, LAST_TICKS)
    )
    for limit in np.geomspace(FIRST_LIMIT, family.limit, STAGES + 1):
        last = limit == family.limit
        stage, steps = (late, LAST_STEPS) if last else (replace(early, limit=float(limit)), STAGE_STEPS)
        for _, better in islice(descend_about_centre(stage.problem(), params), steps):
            params = better
            yield last, params


def train_experts(
    family: ExpertsFit, limits: Limits, listener: Listener, seed: int, deadline: float, stop: threading.Event
) -> SearchResult:
    """Return the parameters with the lowest cost on the selection ticks that a seeded start met under the limit."""
    training, still = family.training, 0
    best = SearchResult(np.arange(family.count), np.empty(0), np.inf, seed, 0, "steps exhausted")
    start = family.start(np.random.default_rng(seed))
    for k, (last, params) in enumerate(descend_in_stages(family, start), 1):
        ended = reason_to_end(limits, best.cost, deadline, stop)
        if last or ended:
            cost, still = training.cost(family.force(params), training.selection), still + 1
            if cost < (1.0 - WORTHWHILE) * best.cost:
                still = 0
            if cost < best.cost:
                best = replace(best, coefficients=params, cost=cost, trials=k)
                listener(best)
        if ended or still >= PATIENCE:
            return replace(best, ended=ended or "no more gain on the selection ticks", share=1.0)
    return replace(best, share=1.0)


def refit(family: ExpertsFit, params: F, weights: F) -> F:
    """Return the parameters after a few more steps on ticks with these weights (ticks,)."""
    every = len(weights) // LAST_TICKS
    again = replace(family, training=take_every(replace(family.training, estimation=weights), every))
    steps = islice(descend_about_centre(again.problem(), params), REFIT_STEPS)
    return [params, *(better for _, better in steps)][-1]
