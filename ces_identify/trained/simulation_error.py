"""Simulation-error training from several seeded starts: Levenberg-Marquardt on the free run, stopped early.

Every start descends on the estimation ticks and keeps the parameters with the least cost on the selection ticks. With
`certify` the gain of past forces is held below MAX_GAIN by a penalty, which is raised until a descent ends there, and
only parameters below it are kept.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import replace
from functools import partial
from typing import Protocol

import numpy as np

from ces_identify.numerics import search_clock
from ces_identify.numerics.arrays import F
from ces_identify.numerics.levenberg import descend
from ces_identify.polynomial.limits import Limits, Listener, SearchResult
from ces_identify.trained.training import Training
from ces_observer.model import Model, Sampling

MAX_GAIN = 0.98  # of past forces: below 1, so that the past fades and the bound on the force is of use
ROOM = 0.002  # below MAX_GAIN, where the penalty begins
PENALTIES = (10.0, 100.0, 1e3, 1e4)  # [(J / 100)^2] of a squared excess of gain, in turn until it is gone
STEPS = 300  # most of a start
PATIENCE = 25  # steps without a gain on the selection ticks, after which a start ends
MIN_GAIN = 1e-3  # relative
NO_MORE_GAIN = "no more gain on the selection ticks"


class Family(Protocol):
    """Models of one structure and size, as parameter vectors (parameters,)."""

    @property
    def training(self) -> Training:
        """What they are fitted to."""

    @property
    def size(self) -> int:
        """Units or rules."""

    def start(self, random: np.random.Generator) -> F:
        """Return parameters to descend from."""

    def errors(self, params: F, max_error: float) -> tuple[float, F, F]:
        """Return the squared error on the estimation ticks (infinite above `max_error`), its matrix and gradient."""

    def force(self, params: F) -> F:
        """Return the free run (ticks,) [N], NaN where it left the force envelope."""

    def gains(self, params: F) -> tuple[F, F]:
        """Return bounds (n,) on the gain of past forces and their gradients (n, parameters)."""

    def model(self, params: F, sampling: Sampling) -> Model:
        """Return the model of these parameters."""


def train(
    family: Family, limits: Limits, certify: bool = True, listener: Listener = lambda found: None
) -> list[SearchResult]:
    """Run the starts in parallel threads; return what each found, best first; those that found nothing are left out.

    Ctrl-C ends every start and returns the best so far. `listener` hears each improvement and each end of a start,
    from the threads. `SearchResult.chosen` counts the family's units or rules; `coefficients` are its parameters.
    """
    stop = threading.Event()
    deadline = search_clock.now() + limits.seconds
    with ThreadPoolExecutor(max(1, limits.threads)) as pool:
        starts = [
            pool.submit(_Start(family, limits, limits.seed + i, certify, deadline, stop, listener).run)
            for i in range(limits.starts)
        ]
        _await(starts, stop)
    found = [start.result() for start in starts]
    return sorted((f for f in found if np.isfinite(f.cost)), key=lambda f: (f.cost, f.seed))


def _await(starts: Sequence[Future[SearchResult]], stop: threading.Event) -> None:
    pending = set(starts)
    while pending:
        try:
            _, pending = wait(pending, return_when=FIRST_COMPLETED)
        except KeyboardInterrupt:
            stop.set()


class _Start:
    """One seeded start."""

    def __init__(
        self,
        family: Family,
        limits: Limits,
        seed: int,
        certify: bool,
        deadline: float,
        stop: threading.Event,
        listener: Listener,
    ) -> None:
        self.family, self.limits, self.certify = family, limits, certify
        self.deadline, self.stop, self.listener = deadline, stop, listener
        self.best = SearchResult(np.arange(family.size), np.empty(0), np.inf, seed, 0, "running")
        self.step = 0
        self.promising, self.promised_at = np.inf, 0  # least selection cost that was a gain, and its step

    def run(self) -> SearchResult:
        """Descend until nothing is gained on the selection ticks; return the best parameters."""
        ended = self._reason_to_end() or self._descend()
        self.best = replace(self.best, ended=ended)
        if np.isfinite(self.best.cost):
            self.listener(self.best)
        return self.best

    def _descend(self) -> str:
        params, ended = self.family.start(np.random.default_rng(self.best.seed)), "start diverged"
        for penalty in PENALTIES:
            self.promising, self.promised_at = np.inf, self.step
            for _, trial in descend(partial(self._compute_errors_with_penalty, penalty=penalty), params):
                if trial is not params or not self.step:
                    self._evaluate(trial)
                params = trial
                self.step += 1
                ended = self._reason_to_end()
                if ended:
                    break
            if ended != NO_MORE_GAIN or self._is_allowed(params):
                break
        return ended or "no step lowers the error"

    def _evaluate(self, params: F) -> None:
        cost = self.family.training.cost(self.family.force(params), self.family.training.selection)
        if cost < self.promising * (1.0 - MIN_GAIN):
            self.promising, self.promised_at = cost, self.step
        if cost < self.best.cost and self._is_allowed(params):
            self.best = replace(self.best, coefficients=params, cost=cost, trials=self.step + 1)
            self.listener(self.best)

    def _reason_to_end(self) -> str:
        if self.stop.is_set():
            return "interrupted"
        if self.best.cost <= self.limits.target:
            return "target cost reached"
        if search_clock.now() > self.deadline:
            return "time is up"
        if self.step - self.promised_at >= PATIENCE:
            return NO_MORE_GAIN
        return "" if self.step < STEPS else "steps exhausted"

    def _compute_errors_with_penalty(self, params: F, most: float, penalty: float) -> tuple[float, F, F]:
        """Return the family's errors with the penalty on gains above MAX_GAIN - ROOM."""
        error, matrix, gradient = self.family.errors(params, most)
        if not self.certify or not np.isfinite(error):
            return error, matrix, gradient
        gains, slopes = self.family.gains(params)
        excess = np.maximum(gains - (MAX_GAIN - ROOM), 0.0)
        active = slopes[excess > 0.0]
        error += penalty * float(excess @ excess)
        return error, matrix + penalty * active.T @ active, gradient - penalty * excess @ slopes

    def _is_allowed(self, params: F) -> bool:
        return not self.certify or bool(self.family.gains(params)[0].max() < MAX_GAIN)
