"""Simulation-error training of models on lagged regressors: Levenberg-Marquardt on the free run, stopped early.

Every start descends on the estimation ticks and keeps the parameters with the lowest cost on the selection ticks. With
`certify`, a penalty holds the gain of the past forces below MAX_GAIN, and only parameters below it are kept.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from ces_data.arrays import F, I
from ces_identify.numerics import search_clock
from ces_identify.numerics.levenberg import descend
from ces_identify.polynomial.search_limits import Limits, Listener, SearchResult
from ces_identify.trained.lagged_kernels import RegressorTable, lagged_free_run, lagged_normal_equations
from ces_identify.trained.training import Training
from ces_observer.model import Envelope, Model, Sampling
from ces_observer.structures.lagged_signals import COLUMNS, Regressor
from ces_observer.structures.structure import Structure


def regressor_table(regressors: Sequence[Regressor], envelope: Envelope, inputs: F, segments: I) -> RegressorTable:
    """Return the regressors of `inputs` (3, ticks), clamped; before a segment they have its first values."""
    values = np.zeros((inputs.shape[1], len(regressors)))
    for j, r in enumerate(regressors):
        if r.signal != "force":
            clamped = np.clip(inputs[COLUMNS[r.signal]], *envelope.by_signal[r.signal])
            values[:, j] = (delay_values(clamped, r.lag, segments) - r.mean) / r.spread
    past = [r if r.signal == "force" else Regressor("force", 0, 0.0, 1.0) for r in regressors]
    return RegressorTable(
        values,
        np.array([r.lag for r in past], np.int64),
        np.array([r.mean for r in past]),
        np.array([r.spread for r in past]),
    )


def unscaled_inputs(lags: Iterable[tuple[str, int]], envelope: Envelope, inputs: F, segments: I) -> F:
    """Return inputs (ticks, n) at lags [ticks] in SI units; `lags` holds names and lags."""
    raw = [Regressor(signal, lag, 0.0, 1.0) for signal, lag in lags]
    return regressor_table(raw, envelope, inputs, segments).values


def delay_values(values: F, lag: int, segments: I) -> F:
    """Return `values` (ticks,) `lag` ticks ago, within each segment."""
    index = np.arange(len(values)) - lag
    for start, stop in segments:
        index[start:stop] = np.maximum(index[start:stop], start)
    return values[np.maximum(index, 0)]


@dataclass(frozen=True)
class Family(ABC):
    """Models on `regressors`, fitted to `training`; `params` is always the vector (parameters,) of one model."""

    training: Training
    regressors: tuple[Regressor, ...]

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of units or rules."""

    @abstractmethod
    def start(self, random: np.random.Generator) -> F:
        """Return random parameters from which a descent starts."""

    @abstractmethod
    def errors_on(self, table: RegressorTable, params: F, max_error: float) -> tuple[float, F, F]:
        """Return the regularised squared error (infinite above `max_error`), its matrix and its gradient."""

    @abstractmethod
    def gains(self, params: F) -> tuple[F, F]:
        """Return upper bounds (n,) of the gain of the past forces and their gradients (n, parameters)."""

    @abstractmethod
    def body(self, params: F) -> Structure:
        """Return the structure with these parameters."""

    @abstractmethod
    def kernel_arrays(self, params: F) -> Any:
        """Return the parameters as the NamedTuple that the kernels take."""

    @cached_property
    def table(self) -> RegressorTable:
        """The regressors over the training ticks."""
        t = self.training
        return regressor_table(self.regressors, t.envelope, t.inputs, t.segments)

    @cached_property
    def past(self) -> I:
        """Indices of the regressors that are past forces."""
        return np.flatnonzero(self.table.past_lags)

    def errors(self, params: F, max_error: float) -> tuple[float, F, F]:
        """Return the errors of the free run, as `errors_on` does."""
        return self.errors_on(self.table, params, max_error)

    def normal_equations(self, table: RegressorTable, params: F, max_error: float) -> tuple[float, F, F]:
        """Return the errors without regularisation."""
        t = self.training
        error, matrix, gradient = lagged_normal_equations(
            table, t.segments, self.kernel_arrays(params), *t.loose, t.measured, t.estimation, max_error
        )
        return error, matrix, gradient

    def force(self, params: F) -> F:
        """Return the free run (ticks,) [N], NaN from where it left the force envelope."""
        t = self.training
        force, _ = lagged_free_run(self.table, t.segments, self.kernel_arrays(params), *t.force_envelope)
        return np.asarray(force)

    def model(self, params: F, sampling: Sampling) -> Model:
        """Return the model with these parameters."""
        return Model(sampling, self.body(params), self.training.envelope, self.training.force_envelope)


MAX_GAIN = 0.98  # of the past forces: less than 1, so that the bound on the force is useful
MARGIN = 0.002  # below MAX_GAIN, where the penalty begins
PENALTIES = (10.0, 100.0, 1e3, 1e4)  # [(J / 100)^2] on a squared excess of gain, raised until there is no excess
MAX_STEPS = 300  # of a start
PATIENCE = 25  # steps without improvement on the selection ticks, after which a start stops
MIN_IMPROVEMENT = 1e-3  # relative
NO_MORE_GAIN = "no more gain on the selection ticks"


def train(
    family: Family, limits: Limits, certificate: bool = True, listener: Listener = lambda result: None
) -> list[SearchResult]:
    """Run the starts in parallel threads and return their results, best first, without starts that failed.

    Ctrl-C stops every start; the best results so far are returned. The threads call `listener` at each improvement and
    when a start stops. `SearchResult.chosen` counts the family's units or rules; `coefficients` are its parameters.
    """
    stop = threading.Event()
    deadline = search_clock.now() + limits.time
    with ThreadPoolExecutor(max(1, limits.threads)) as pool:
        starts = [
            pool.submit(_Start(family, limits, limits.seed + i, certificate, deadline, stop, listener).run)
            for i in range(limits.starts)
        ]
        pending = set(starts)
        while pending:
            try:
                _, pending = wait(pending, return_when=FIRST_COMPLETED)
            except KeyboardInterrupt:
                stop.set()
    results = [start.result() for start in starts if np.isfinite(start.result().cost)]
    return sorted(results, key=lambda result: (result.cost, result.seed))


@dataclass
class _Start:
    """One seeded start."""

    family: Family
    limits: Limits
    seed: int
    certificate: bool
    deadline: float
    stop: threading.Event
    listener: Listener
    step: int = 0
    lowest: float = np.inf  # selection cost of the last real improvement,
    improved_at: int = 0  # and its step

    def __post_init__(self) -> None:
        self.best = SearchResult(np.arange(self.family.size), np.empty(0), np.inf, self.seed, 0, "running")

    def run(self) -> SearchResult:
        """Descend until the cost on the selection ticks stops falling; return the best parameters."""
        ended = self._find_stop_reason() or self._descend()
        self.best = replace(self.best, ended=ended)
        if np.isfinite(self.best.cost):
            self.listener(self.best)
        return self.best

    def _descend(self) -> str:
        params, ended = self.family.start(np.random.default_rng(self.seed)), "start diverged"
        for penalty in PENALTIES:
            self.lowest, self.improved_at = np.inf, self.step
            for _, trial in descend(partial(self._compute_errors_with_penalty, penalty=penalty), params):
                if trial is not params or not self.step:
                    self._evaluate(trial)
                params = trial
                self.step += 1
                ended = self._find_stop_reason()
                if ended:
                    break
            if ended != NO_MORE_GAIN or self._is_allowed(params):
                break
        return ended or "no step lowers the error"

    def _evaluate(self, params: F) -> None:
        cost = self.family.training.cost(self.family.force(params), self.family.training.selection)
        if cost < self.lowest * (1.0 - MIN_IMPROVEMENT):
            self.lowest, self.improved_at = cost, self.step
        if cost < self.best.cost and self._is_allowed(params):
            self.best = replace(self.best, coefficients=params, cost=cost, trials=self.step + 1)
            self.listener(self.best)

    def _find_stop_reason(self) -> str:
        if self.stop.is_set():
            return "interrupted"
        if self.best.cost <= self.limits.target:
            return "target cost reached"
        if search_clock.now() > self.deadline:
            return "time is up"
        if self.step - self.improved_at >= PATIENCE:
            return NO_MORE_GAIN
        return "" if self.step < MAX_STEPS else "steps exhausted"

    def _compute_errors_with_penalty(self, params: F, max_error: float, penalty: float) -> tuple[float, F, F]:
        """Return the family's errors with the penalty on gains above MAX_GAIN - MARGIN."""
        error, matrix, gradient = self.family.errors(params, max_error)
        if not self.certificate or not np.isfinite(error):
            return error, matrix, gradient
        gains, slopes = self.family.gains(params)
        excess = np.maximum(gains - (MAX_GAIN - MARGIN), 0.0)
        active = slopes[excess > 0.0]
        error += penalty * float(excess @ excess)
        return error, matrix + penalty * active.T @ active, gradient - penalty * excess @ slopes

    def _is_allowed(self, params: F) -> bool:
        return not self.certificate or bool(self.family.gains(params)[0].max() < MAX_GAIN)
