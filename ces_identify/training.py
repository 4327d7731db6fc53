"""What models on lagged regressors are trained on: stacked series and regressors; families of such models.

Estimation and selection are the alternating blocks of `ces_identify.polynomial.problem`, and every recording has the
same weight. The kernel is the loop of all these fits: the free run, and its sensitivities to every parameter. The force
is that of `ces_observer.tick`; a structure adds the derivatives of a tick. `segments[s] = (start, stop)` are ticks
without a gap; forces before them are zero.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from math import inf
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from ces_data.arrays import F, I
from ces_identify.numerics.core import compile_tick, pointer, run_batch, with_names
from ces_identify.numerics.least_squares import (
    BLOCK,
    NO_MODEL,
    NormalEquations,
    Penalty,
    accumulate,
    longest_lag,
    mirror,
    propagate,
)
from ces_identify.polynomial.problem import assemble_problem
from ces_identify.prepare.cost import EQUAL, Weighting
from ces_identify.prepare.series import Series, changes
from ces_observer.errors import CesError, ModelError
from ces_observer.model import Envelope, Model, Sampling
from ces_observer.structures.lagged_signals import RINGS, Regressor
from ces_observer.structures.polynomial import Term
from ces_observer.structures.structure import OperatingRange, Range, Structure
from ces_observer.tick.lagged import LAGGED_PHI

SIGNALS = ("position", "speed", "current")
DECAY = 3e-6  # [(J / 100)^2] cost of a squared parameter, by which unused ones fade
LOOSE = 1e3  # limit of the force in a descent, in standard deviations


@dataclass(frozen=True)
class Lags:
    """Which regressors to use: lags of past forces [ticks], and delays of the inputs [s], rounded to ticks."""

    force: tuple[int, ...] = (1,)
    speed_s: tuple[float, ...] = (0.0, 0.003)
    current_s: tuple[float, ...] = (0.008,)
    position_s: tuple[float, ...] = ()


@dataclass(frozen=True)
class LagCounts:
    """How many past forces (from one tick ago), currents and speeds (from this tick on) to use: thesis table 5.2."""

    forces: int
    currents: int
    speeds: int

    def at_rate(self, rate_Hz: float) -> Lags:
        """Return the lags at a model's rate; a tick is a tick at every rate."""
        currents, speeds = (tuple(k / rate_Hz for k in range(count)) for count in (self.currents, self.speeds))
        return Lags(tuple(range(1, self.forces + 1)), speeds, currents)


LAG_SETS: tuple[Lags | LagCounts, ...] = (  # among which the data choose
    Lags(),
    Lags((1, 2), (0.0, 0.002, 0.004, 0.008), (0.0, 0.004, 0.008, 0.016)),
    LagCounts(2, 4, 5),
)


@dataclass(frozen=True)
class Training:
    """Stacked series: `inputs` (3, ticks) position [m], speed [m/s] and current [A], `measured` force (ticks,) [N].

    `estimation` and `selection` (ticks,) weight squared errors so that those of a recording sum to (J / 100)^2; no tick
    has both. `recordings` is each segment's recording. `scale_N` is the standard deviation of the measured force.
    """

    inputs: F
    measured: F
    segments: I
    recordings: I
    estimation: F
    selection: F
    envelope: Envelope
    force_envelope: Range
    scale_N: float

    @property
    def everything(self) -> F:
        """Weights (ticks,) of all scored ticks."""
        return self.estimation + self.selection

    @property
    def loose(self) -> Range:
        """Bounds [N] of the force during a descent, which may leave the force envelope for a while."""
        return -LOOSE * self.scale_N, LOOSE * self.scale_N

    @property
    def level(self) -> float:
        """Mean measured force on the estimation ticks, in standard deviations."""
        return float(self.estimation @ self.measured / self.estimation.sum()) / self.scale_N

    def cost(self, force: F, weights: F) -> float:
        """Return the mean J [%] of `force` (ticks,) over the recordings; infinite if a force is not finite."""
        if not np.isfinite(force).all():
            return float("inf")
        errors = weights * (force - self.measured) ** 2
        shares = np.zeros(self.recordings.max() + 1)
        for (start, stop), recording in zip(self.segments, self.recordings, strict=True):
            shares[recording] += errors[start:stop].sum()
        return float(100.0 * np.sqrt(shares).mean())

    def regressor(self, signal: str, lag: int) -> Regressor:
        """Return a regressor scaled by mean and standard deviation; a past force by the latter alone."""
        if signal == "force":
            return Regressor(signal, lag, 0.0, self.scale_N)
        values = self.inputs[SIGNALS.index(signal)]
        spread = float(values.std())
        return Regressor(signal, lag, float(values.mean()), spread if spread > 1e-9 else 1.0)

    def changing_inputs(self) -> set[str]:
        """Return the names of the inputs that are not constant."""
        return {name for name, row in zip(SIGNALS, self.inputs, strict=True) if changes(row)}


def build_regressors(data: Training, lags: Lags | LagCounts, rate_Hz: float) -> tuple[Regressor, ...]:
    """Return the scaled regressors, without those of constant inputs; raises CesError if none is left."""
    lags = lags.at_rate(rate_Hz) if isinstance(lags, LagCounts) else lags
    delays = {"speed": lags.speed_s, "current": lags.current_s, "position": lags.position_s}
    chosen = [("force", lag) for lag in lags.force]
    for signal, seconds in delays.items():
        if signal in data.changing_inputs():
            chosen += [(signal, lag) for lag in dict.fromkeys(round(s * rate_Hz) for s in seconds)]
    if not chosen:
        raise CesError("every input among the regressors is constant; use past forces or another input, too")
    return tuple(data.regressor(signal, lag) for signal, lag in chosen)


def build_training(series: Sequence[Series], weighting: Weighting = EQUAL) -> Training:
    """Return the data to fit to; raises RecordingError if there is too little."""
    problem = assemble_problem(series, (Term(1.0, ()),), weighting=weighting)
    scored = problem.everything > 0.0
    return Training(
        inputs=np.concatenate([s.inputs for s in series], axis=1),
        measured=problem.measured,
        segments=problem.segments,
        recordings=problem.recordings,
        estimation=np.where(problem.selection > 0.0, 0.0, problem.everything),
        selection=problem.selection,
        envelope=problem.envelope,
        force_envelope=problem.force_envelope,
        scale_N=float(problem.measured[scored].std()),
    )


class RegressorTable(NamedTuple):
    """Regressors over the ticks: `values` (ticks, regressors), 0 where a past force belongs.

    `past_lags` (regressors,) is the lag of a past force, 0 for an input; `past_means` and `past_spreads` scale it.
    """

    values: F
    past_lags: I
    past_means: F
    past_spreads: F


def regressor_table(regressors: Sequence[Regressor], envelope: Envelope, inputs: F, segments: I) -> RegressorTable:
    """Return the regressors of `inputs` (3, ticks), clamped; before a segment they have its first values."""
    values = np.zeros((inputs.shape[1], len(regressors)))
    for j, r in enumerate(regressors):
        if r.signal != "force":
            clamped = np.clip(inputs[RINGS.index(r.signal)], *envelope.by_signal[r.signal])
            values[:, j] = (delay_values(clamped, r.lag, segments) - r.mean) / r.spread
    past = [r if r.signal == "force" else Regressor("force", 0, 0.0, 1.0) for r in regressors]
    past_lags = np.array([r.lag for r in past], np.int64)
    return RegressorTable(values, past_lags, np.array([r.mean for r in past]), np.array([r.spread for r in past]))


def delay_values(values: F, lag: int, segments: I) -> F:
    """Return `values` (ticks,) `lag` ticks ago, within each segment."""
    index = np.arange(len(values)) - lag
    for start, stop in segments:
        index[start:stop] = np.maximum(index[start:stop], start)
    return values[np.maximum(index, 0)]


def with_measured_past(table: RegressorTable, data: Training) -> RegressorTable:
    """Return the regressors with measured forces instead of the model's own past forces."""
    values = table.values.copy()
    for j in np.flatnonzero(table.past_lags):
        past = delay_values(data.measured, int(table.past_lags[j]), data.segments)
        values[:, j] = (past - table.past_means[j]) / table.past_spreads[j]
    return table._replace(values=values, past_lags=np.zeros_like(table.past_lags))


def _force(p: F, n: I, s: F) -> float:
    raise NotImplementedError


def _fill_slopes(p: F, n: I, s: F, y: float, past_lags: I, past_spreads: F, row: F, gains: F) -> None:
    raise NotImplementedError


def _normal_equations(
    numbers: F, counts: I, states: F, table: RegressorTable, segments: I, parameters: int, low: float, high: float,
    measured: F, weights: F, max_error: float,
) -> tuple[float, F, F]:  # fmt: skip
    p, n, s = pointer(numbers), pointer(counts), pointer(states)
    values, past_lags, past_means, past_spreads = table
    width, phi, depth = values.shape[1], n[LAGGED_PHI], longest_lag(past_lags)
    matrix, gradient, gains = np.zeros((parameters, parameters)), np.zeros(parameters), np.empty(width)
    past, slopes = np.empty(depth + BLOCK), np.empty((depth + BLOCK, parameters))
    total = 0.0
    for segment in range(len(segments)):
        start, stop = segments[segment, 0], segments[segment, 1]
        past[:depth] = 0.0
        slopes[:depth] = 0.0
        for k0 in range(start, stop, BLOCK):
            ticks = min(k0 + BLOCK, stop) - k0
            for now in range(depth, depth + ticks):
                for j in range(width):
                    s[phi + j] = values[k0 + now - depth, j]
                    if past_lags[j] > 0:
                        s[phi + j] = (past[now - past_lags[j]] - past_means[j]) / past_spreads[j]
                y = _force(p, n, s)
                past[now] = y
                if not low <= y <= high:
                    return inf, matrix, gradient
                _fill_slopes(p, n, s, y, past_lags, past_spreads, slopes[now], gains)
                propagate(slopes, now, past_lags, gains)
            errors = measured[k0 : k0 + ticks] - past[depth : depth + ticks]
            total += accumulate(matrix, gradient, slopes[depth : depth + ticks], errors, weights[k0 : k0 + ticks])
            if total > max_error:
                return inf, matrix, gradient
            past[:depth] = past[ticks : ticks + depth].copy()
            slopes[:depth] = slopes[ticks : ticks + depth].copy()
    mirror(matrix)
    return total, matrix, gradient


@cache
def normal_equations(force: Callable[..., float], fill_slopes: Callable[..., None]) -> Any:
    """Return the function of weighted squared error, Gauss-Newton matrix and (descending) gradient of the free run.

    `run(p, n, s, table, segments, parameters, low, high, measured, weights, max_error)` takes arrays of the tick. If
    the force leaves [low, high] or the error exceeds `max_error`, the error is infinite and the rest incomplete.

    `force(p, n, s)` is a function of the tick: the force at the regressors in s. `fill_slopes(p, n, s, y, past_lags,
    past_spreads, row, gains)` is a kernel that is called after it: it fills `row` (parameters,) with the derivatives of
    this force y by the parameters, and `gains` (regressors,) with those by the past forces.
    """
    names = {"_force": compile_tick(force), "_fill_slopes": fill_slopes}
    return with_names(_normal_equations, f"normal_equations_{force.__name__}", names)


@dataclass(frozen=True)
class LaggedModels(ABC):
    """Models on `regressors`, fitted to `training`; `params` is always the vector (parameters,) of one model."""

    training: Training
    regressors: tuple[Regressor, ...]
    kernel: ClassVar[Any]  # normal equations, as `ces_identify.training.normal_equations` returns them

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of units, rules or experts."""

    @abstractmethod
    def start(self, random: np.random.Generator) -> F:
        """Return random parameters from which a descent starts."""

    @abstractmethod
    def body(self, params: F) -> Structure:
        """Return the structure with these parameters."""

    @property
    def columns(self) -> tuple[Regressor, ...]:
        """The columns of the table, in the order of `ces_observer.tick.lagged`."""
        return self.regressors

    @cached_property
    def table(self) -> RegressorTable:
        """The columns over the training ticks."""
        t = self.training
        return regressor_table(self.columns, t.envelope, t.inputs, t.segments)

    @property
    def within(self) -> OperatingRange:
        """The ranges of the training data; lags are in ticks, so that a rate does not matter."""
        return OperatingRange(1.0, self.training.envelope.by_signal, self.training.force_envelope)

    @property
    @abstractmethod
    def pull(self) -> Penalty:
        """The regularisation."""

    def normal_equations(self, table: RegressorTable, params: F, max_error: float) -> NormalEquations:
        """Return the normal equations of the free run on the estimation ticks, with the columns of `table`."""
        t = self.training
        try:
            p, n, s, _ = self.body(params).lay_out(self.within).arrays()
        except ModelError:
            return NO_MODEL
        arrays = np.array(p), np.array(n, np.int64), np.array(s)
        data = t.segments, len(params), *t.loose, t.measured, t.estimation
        return NormalEquations(*self.kernel(*arrays, table, *data, max_error))

    def equations(self, params: F, max_error: float) -> NormalEquations:
        """Return the normal equations of a fit."""
        return self.normal_equations(self.table, params, max_error)

    def force(self, params: F, force_N: Range | None = None) -> F:
        """Return the free run (ticks,) [N], NaN where it would leave a range [N], by default the force envelope."""
        t, within = self.training, self.within if force_N is None else replace(self.within, force_N=force_N)
        force, held = run_batch(self.body(params), within, t.inputs, t.segments)
        return np.where(held, np.nan, force)

    def model(self, params: F, sampling: Sampling) -> Model:
        """Return the model with these parameters."""
        return Model(sampling, self.body(params), self.training.envelope, self.training.force_envelope)


@dataclass(frozen=True)
class Family(LaggedModels):
    """Models of a size on a ladder of sizes, with a limit on the gain of the past forces."""

    @abstractmethod
    def smaller(self) -> Self | None:
        """Return the models of the next smaller size from which a start begins, None if these are the smallest."""

    @abstractmethod
    def grow(self, smaller: Self, params: F, random: np.random.Generator) -> F:
        """Return parameters of these models that repeat, or nearly, a smaller one with the parameters `params`."""

    def ladder(self) -> list[Self]:
        """Return the models of all sizes on the way to this one."""
        smaller = self.smaller()
        return [self] if smaller is None else [*smaller.ladder(), self]

    @abstractmethod
    def gains(self, params: F) -> tuple[F, F]:
        """Return upper bounds (n,) of the gain of the past forces and their gradients (n, parameters)."""

    @cached_property
    def past(self) -> I:
        """Indices of the regressors that are past forces."""
        return np.flatnonzero(self.table.past_lags)
