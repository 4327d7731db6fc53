"""Gated experts at the desk: fit and report. A model forgets its past within a stated time by its form.

A descent on the free run under the final limit of the gains, from a random start, ends in poor places. So the limit
begins above 1, where a model need not forget, and comes down in steps; each descent goes on from the last one's
parameters.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from math import log
from typing import ClassVar

import numpy as np

from ces_observer.limits import FileLimits
from ces_data.arrays import F, I
from ces_identify.numerics.core import core_kernel
from ces_identify.numerics.least_squares import NormalEquations, Penalty, check_error_first, improve, pull_towards
from ces_identify.numerics.search import NO_MORE_GAIN, STEPS_DONE, Listener, SearchResult, SearchStart, run_starts
from ces_identify.prepare.series import Series, SimulatedSeries
from ces_identify.structures.kit import Fitted, IdentifyOptions, StructureKit, check_whole, require_models
from ces_identify.structures.mixture import mean_of
from ces_identify.training import (
    DECAY,
    LaggedModels,
    Lags,
    Training,
    build_regressors,
    build_training,
    normal_equations,
)
from ces_observer.model import Model, Sampling
from ces_observer.options import Option
from ces_observer.proof.certificate import largest_gain
from ces_observer.structures.experts import Expert, Experts
from ces_observer.structures.lagged_signals import longest_lags
from ces_observer.tick.experts import (
    EXPERTS_COUNT, EXPERTS_GAINS, EXPERTS_LAYER, EXPERTS_OUTPUTS, EXPERTS_SCALE, experts_force,
)  # fmt: skip
from ces_observer.tick.lagged import LAGGED_PHI
from ces_report.table import Section, parameter_section
from ces_report.typesetting import describe_signals, four_figures, signal_symbol

EARLY_TICKS, LAST_TICKS = 8_000, 20_000  # that count before the last stage and in it, about
FIRST_LIMIT, STAGES = 1.1, 8  # of the gains; steps down to the final one (Keio: 8.2 %, 11.1 % straight)
STAGE_STEPS, LAST_STEPS, REFIT_STEPS = 12, 60, 6
PATIENCE, WORTHWHILE = 10, 1e-3  # steps without this relative fall of the selection cost, after which a descent ends
FIRST_GAIN, FIRST_ROOM = 0.9, 0.3  # of a start, towards which the fit is pulled
FIRST_ROWS = (1.0, 0.1, 0.5)  # standard deviations of gates, and of linear parts and bends over 1 - FIRST_GAIN
GAIN_PULL = 1e-5  # [(J / 100)^2] of a squared change of a gain's or room's parameter
LAGS_S = (0.0, 1e-3, 3e-3, 7e-3, 15e-3)  # of speed and current (Dyke: 15 %; with the last four ticks of 3 kHz 20 %),
LEAST_LAGS = 4  # and at least so many (Keio, 200 Hz: 9 %, with three 11 %)
STARTS, MEMBERS = 6, 3  # starts at most; of these in the mean
STARTS_TICKS = 120_000  # of all starts together; there are MEMBERS at least
ROUNDING = 1e-12  # relative, of the limit of a gain


@core_kernel
def fill_experts_slopes(p: F, n: I, s: F, y: float, past_lags: I, past_spreads: F, row: F, gains: F) -> None:
    """Fill `row` with the derivatives of a tick's force by the parameters, `gains` with those by the past forces.

    Parameters of E experts on R inputs: the rows of the layer, gates, linear and bend (each E rows of R + 1 numbers),
    then a, d and s of each expert.
    """
    scale, phi, share, gain, r = p[EXPERTS_SCALE], n[LAGGED_PHI], n[EXPERTS_OUTPUTS], n[EXPERTS_GAINS], len(gains) - 1
    count, past, blended = n[EXPERTS_COUNT], s[n[LAGGED_PHI] + r], y / p[EXPERTS_SCALE]
    block, gains[:] = count * (r + 1), 0.0
    layer = n[EXPERTS_LAYER] + 2 * block
    for i in range(count):
        part = scale * s[share + i]
        bend = s[share + 2 * count + i]
        steep = part * (1.0 - bend * bend)
        gate = part * (s[share + count + i] - blended)
        at, bent = i * (r + 1), p[layer + i * (r + 1) + r] + p[gain + 1] * past
        for j in range(r):
            u = s[phi + j]
            bent += p[layer + at + j] * u
            row[at + j] = gate * u
            row[block + at + j] = part * u
            row[2 * block + at + j] = steep * u
        row[at + r], row[block + at + r], row[2 * block + at + r] = gate, part, steep
        at = 3 * block + 3 * i
        row[at] = part * past
        row[at + 1] = steep * past
        row[at + 2] = part * bend - steep * bent / p[gain + 2]
        gains[r] += part * p[gain] + steep * p[gain + 1]
        gain += 3
    gains[r] /= past_spreads[r]


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

    @property
    def pull(self) -> Penalty:
        """The pull of weights towards 0, and of gains and rooms towards the usual ones."""
        weights = np.concatenate([np.full(self.rows, self.decay), np.full(3 * self.count, GAIN_PULL)])
        return pull_towards(self.centre, weights)

    def improve(self, params: F, steps: int) -> Iterator[F]:
        """Yield better parameters after each of some steps of a descent."""
        equations = check_error_first(self.error, self.differentiate)
        for point in islice(improve(equations, params, [self.pull]), 1, 1 + steps):
            yield point.params

    def error(self, params: F) -> float:
        """Return the free run's squared error on the estimation ticks, infinite if it is not finite."""
        t = self.training
        error = t.estimation @ (self.force(params, t.loose) - t.measured) ** 2
        return float(error) if np.isfinite(error) else np.inf

    def differentiate(self, params: F) -> NormalEquations:
        """Return the normal equations by the parameters, from those by the numbers of the tick."""
        error, matrix, gradient = self.equations(params, np.inf)
        if not np.isfinite(error):
            return NormalEquations(error, matrix, gradient)
        _, gains, rooms = self.split(params)
        slopes = gains * (1.0 - gains / self.limit)
        to = np.zeros((self.count, 3, 3))
        to[:, 0, 0], to[:, 1, 0], to[:, 1, 1], to[:, 2, 2] = slopes[:, 0], -slopes[:, 0], slopes[:, 1], rooms
        for at, own in zip(range(self.rows, len(params), 3), to, strict=True):
            part = slice(at, at + 3)
            gradient[part] = own.T @ gradient[part]
            matrix[:, part] = matrix[:, part] @ own
            matrix[part] = own.T @ matrix[part]
        return NormalEquations(error, matrix, gradient)


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
        for better in stage.improve(params, steps):
            params = better
            yield last, params


def train_experts(family: ExpertsFit, start: SearchStart) -> SearchResult:
    """Return the parameters with the lowest cost on the selection ticks that a start met under the limit."""
    training, still, ended = family.training, 0, ""
    for k, (last, params) in enumerate(descend_in_stages(family, family.start(start.random)), 1):
        ended = start.reason_to_end()
        if last or ended:
            cost, still = training.cost(family.force(params), training.selection), still + 1
            if cost < (1.0 - WORTHWHILE) * start.best.cost:
                still = 0
            if cost < start.best.cost:
                start.keep(chosen=np.arange(family.count), coefficients=params, cost=cost, trials=k)
        ended = ended or (NO_MORE_GAIN if still >= PATIENCE else "")
        if ended:
            break
    return replace(start.best, ended=ended or STEPS_DONE, share=1.0)


def choose_lags(rate_Hz: float) -> tuple[float, ...]:
    """Return the lags [s] of the inputs: those of LAGS_S in whole ticks, or the first ticks if these are too few."""
    ticks = sorted({round(lag * rate_Hz) for lag in LAGS_S})
    return tuple(k / rate_Hz for k in (ticks if len(ticks) >= LEAST_LAGS else range(LEAST_LAGS)))


def fit_experts(
    count: int, series: Sequence[Series], sampling: Sampling, options: IdentifyOptions, listener: Listener
) -> Fitted:
    """Return the mean of the best starts; raises CesError if no start gives a model."""
    training = build_training(series, options.weight)
    lags_s = choose_lags(sampling.rate_Hz)
    past, *inputs = build_regressors(training, Lags((1,), lags_s, lags_s), sampling.rate_Hz)
    limit = largest_gain(options.forget, *longest_lags((*inputs, past)), sampling.rate_Hz) * (1.0 - ROUNDING)
    family = ExpertsFit(training, (*inputs, past), count, limit, DECAY)
    starts = min(options.limits.starts, STARTS, max(MEMBERS, STARTS_TICKS // len(training.measured)))
    limits = replace(options.limits, starts=starts)
    listener("training local linear models")
    results = require_models(run_starts(limits, listener, partial(train_experts, family)), EXPERTS.option)
    members = [start.coefficients for start in results[:MEMBERS]]
    mean = np.mean([family.force(params) for params in members], axis=0)
    results[0] = replace(results[0], cost=training.cost(mean, training.selection))
    listener(results[0])
    make = partial(_make_mean, family, sampling, members)
    how = {
        "method": "Levenberg-Marquardt on the free-run error, from free gains into bounded ones; the mean of the best",
        "parameters": sum(map(len, members)),
    }
    return Fitted(make(np.ones(len(training.measured))), results, how, make)


def _make_mean(family: ExpertsFit, sampling: Sampling, members: Sequence[F], weights: F) -> Model:
    """Return the mean of members, or the only one, fitted to the weighted ticks as `Fitted.refit` describes it."""
    data = replace(family.training, estimation=weights * family.training.everything)
    again = replace(family, training=take_every(data, len(weights) // LAST_TICKS))
    models = [family.model([params, *again.improve(params, REFIT_STEPS)][-1], sampling) for params in members]
    if len(models) == 1:
        return replace(models[0], certificate=models[0].certify().to_mapping())
    return mean_of(models, [1.0 / len(models)] * len(models))


def experts_table(body: Experts, model: Model, runs: Sequence[SimulatedSeries], role: str) -> Section:
    """Return the experts: the gain of each input, and the time in which a past force fades."""
    about = (
        f"{len(body.experts)} experts, each a recursion of its own, blended by shares that depend on the inputs alone. "
        "Numbers: force [N] for a change of an input by one standard deviation, without the bend."
    )
    heads = ("Expert", *(signal_symbol(r.signal, r.lag) for r in body.inputs), "Fades in [ms]")
    rows = []
    for number, expert in enumerate(body.experts, 1):
        slowest = max(expert.past, expert.past + expert.past_bend)
        fades = 1e3 / (-log(slowest) * model.sampling.rate_Hz) if 0.0 < slowest < 1.0 else 0.0
        forces = (four_figures(body.scale_N * weight) for weight in expert.linear[:-1])
        rows.append((str(number), *forces, four_figures(fades)))
    symbols = describe_signals((r.signal for r in body.inputs), model.sampling.rate_Hz)
    return parameter_section(about, heads, rows, symbols)


COUNT = Option(
    "experts", "6", "number of gated experts", form=f"1 to {FileLimits.MAX_ITEMS}",
    check_text=check_whole(1, FileLimits.MAX_ITEMS), metavar="N",
)  # fmt: skip
EXPERTS = StructureKit(
    about="gated experts that forget",
    body=Experts,
    sizes=(COUNT,),
    fitter=lambda sizes: partial(fit_experts, int(sizes["experts"])),
    table=experts_table,
    auto_work=1.0,
)
