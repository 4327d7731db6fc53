"""Simulation-error training from several random starts: Levenberg-Marquardt on the free run, stopped early.

Every start descends on the estimation ticks and keeps the parameters with the lowest cost on the selection ticks. With
`certify`, a penalty holds the gain of the past forces below MAX_GAIN, and only parameters below it are kept.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ces_identify.numerics import search_clock
from ces_identify.numerics.arrays import F
from ces_identify.numerics.levenberg import descend
from ces_identify.polynomial.search_limits import Limits, Listener, SearchResult
from ces_identify.trained.family import Family

MAX_GAIN = 0.98  # of the past forces: less than 1, so that the bound on the force is useful
MARGIN = 0.002  # below MAX_GAIN, where the penalty begins
PENALTIES = (10.0, 100.0, 1e3, 1e4)  # [(J / 100)^2] on a squared excess of gain, raised until there is no excess
MAX_STEPS = 300  # of a start
PATIENCE = 25  # steps without improvement on the selection ticks, after which a start stops
MIN_IMPROVEMENT = 1e-3  # relative
NO_MORE_GAIN = "no more gain on the selection ticks"


def train(
    family: Family, limits: Limits, certify: bool = True, listener: Listener = lambda result: None
) -> list[SearchResult]:
    """Run the starts in parallel threads and return their results, best first, without starts that failed.

    Ctrl-C stops every start; the best results so far are returned. The threads call `listener` at each improvement and
    when a start stops. `SearchResult.chosen` counts the family's units or rules; `coefficients` are its parameters.
    """
    stop = threading.Event()
    deadline = search_clock.now() + limits.seconds
    with ThreadPoolExecutor(max(1, limits.threads)) as pool:
        starts = [
            pool.submit(_Start(family, limits, limits.seed + i, certify, deadline, stop, listener).run)
            for i in range(limits.starts)
        ]
        _await(starts, stop)
    results = [start.result() for start in starts if np.isfinite(start.result().cost)]
    return sorted(results, key=lambda result: (result.cost, result.seed))


def _await(starts: Sequence[Future[SearchResult]], stop: threading.Event) -> None:
    pending = set(starts)
    while pending:
        try:
            _, pending = wait(pending, return_when=FIRST_COMPLETED)
        except KeyboardInterrupt:
            stop.set()


@dataclass
class _Start:
    """One seeded start."""

    family: Family
    limits: Limits
    seed: int
    certify: bool
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
        if not self.certify or not np.isfinite(error):
            return error, matrix, gradient
        gains, slopes = self.family.gains(params)
        excess = np.maximum(gains - (MAX_GAIN - MARGIN), 0.0)
        active = slopes[excess > 0.0]
        error += penalty * float(excess @ excess)
        return error, matrix + penalty * active.T @ active, gradient - penalty * excess @ slopes

    def _is_allowed(self, params: F) -> bool:
        return not self.certify or bool(self.family.gains(params)[0].max() < MAX_GAIN)
