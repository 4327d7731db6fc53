"""The fit of physical models: several starts, then strength of the penalty and size, all by the selection ticks.

The data's alternating blocks serve estimation (Levenberg-Marquardt on the free run's error, exact derivatives) and
selection (cost of the free run). The best model is fitted once more to all ticks.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ces_data.arrays import F
from ces_identify.numerics import search_clock
from ces_identify.numerics.levenberg import BoundedProblem, descend_within_bounds
from ces_identify.physical.models import PhysicalModels
from ces_identify.polynomial.search_limits import Limits, Listener, SearchResult, reason_to_end

MAX_STARTS = 2
SPREAD = 0.7  # of the logarithms of a perturbed start's groups
PENALTIES = (0.03, 0.1, 0.01, 0.003, 0.001)  # [J %] of a change of one parameter by its scale; the first is for starts
WORTHWHILE = 0.995  # a weaker penalty must lower the selection cost to this share for a still weaker one to be tried
MIN_GAIN = 1e-3  # mean relative fall of the error a step, over WINDOW steps, below which a descent has ended
WINDOW = 4
MAX_STEPS = 60
LARGER = 0.98  # a larger size must lower the selection cost to this share


@dataclass(frozen=True)
class PhysicalFit:
    """Parameters of one model of `models`, its cost on the selection ticks [%], and the penalty's strength."""

    models: PhysicalModels[Any]
    theta: F
    cost: float
    penalty: float
    result: SearchResult


@dataclass
class PhysicalSearch:
    """One search; `stop` or the deadline ends it with the best so far."""

    limits: Limits
    listener: Listener
    stop: threading.Event = field(default_factory=threading.Event)
    ended: str = "no step lowers the error"

    def __post_init__(self) -> None:
        self._deadline = search_clock.now() + self.limits.time
        self._lock = threading.Lock()
        self._best = np.inf
        self._trials = 0
        self._found: list[PhysicalFit] = []

    def run(
        self, smallest: PhysicalModels[Any], sizes: Sequence[PhysicalModels[Any]], short: bool = False
    ) -> list[PhysicalFit]:
        """Return the fits so far, best first, also after Ctrl-C; with `short`, one start of the `smallest` models."""
        try:
            self._run_starts(smallest, 1 if short else min(self.limits.starts, MAX_STARTS))
            if not short and self._found:
                self._vary_penalty(self._sorted()[0])
                best = self._sorted()[0]
                for models in sizes:  # one counts only if it is clearly better
                    self._fit(models, models.layout.start, best.penalty, 0, LARGER * best.cost)
        except KeyboardInterrupt:
            self.stop.set()
        return self._sorted()

    def refit(self, fit: PhysicalFit, share: F | float = 1.0) -> F:
        """Return the parameters after a last fit to all ticks, weighted by `share` (ticks,), if it is not worse."""
        everything = (fit.models.training.estimation + fit.models.training.selection) * share
        before = fit.models.cost(fit.theta, everything)
        steps = [theta for _, theta in self._descend(fit.models, everything, fit.theta, fit.penalty)]
        theta = steps[-1] if steps else fit.theta
        return theta if fit.models.cost(theta, everything) <= before else fit.theta

    def _run_starts(self, models: PhysicalModels[Any], count: int) -> None:
        with ThreadPoolExecutor(max(1, self.limits.threads)) as pool:
            runs = [pool.submit(self._fit, models, self._start(models, i), PENALTIES[0], i) for i in range(count)]
            try:
                for run in runs:
                    run.result()
            except KeyboardInterrupt:
                self.stop.set()
                raise

    def _start(self, models: PhysicalModels[Any], i: int) -> F:
        if i == 0:
            return models.layout.start
        return models.layout.perturbed(np.random.default_rng(self.limits.seed + i), SPREAD)

    def _vary_penalty(self, best: PhysicalFit) -> None:
        """Fit on from the best with other strengths of the penalty; go on while a weaker one helps."""
        at = best
        for penalty in PENALTIES[2:]:
            weaker = self._fit(best.models, at.theta, penalty, 0)
            if weaker.cost > WORTHWHILE * at.cost:
                break
            at = weaker
        if at is best:
            self._fit(best.models, best.theta, PENALTIES[1], 0)

    def _fit(
        self, models: PhysicalModels[Any], start: F, penalty: float, seed: int, below: float = np.inf
    ) -> PhysicalFit:
        """Return the parameters with the lowest selection cost of one descent; keep them if that is `below` a cost."""
        training = models.training
        best = self._as_fit(models, models.layout.project(start), np.inf, penalty, seed)
        try:
            for _, theta in self._descend(models, training.estimation, start, penalty):
                cost = models.cost(theta, training.selection)
                if cost < best.cost:
                    best = self._as_fit(models, theta, cost, penalty, seed)
                    self._report(best)
        finally:
            best = self._as_fit(models, best.theta, best.cost, penalty, seed, self._find_stop_reason() or self.ended)
            if best.cost < below and np.isfinite(best.cost):
                self._found.append(best)
        self.listener(best.result)
        return best

    def _as_fit(
        self, models: PhysicalModels[Any], theta: F, cost: float, penalty: float, seed: int, ended: str = "running"
    ) -> PhysicalFit:
        result = SearchResult(np.arange(len(theta)), theta, cost, self.limits.seed + seed, self._trials, ended)
        return PhysicalFit(models, theta, cost, penalty, result)

    def _report(self, fit: PhysicalFit) -> None:
        with self._lock:
            self._trials += 1
            if fit.cost >= self._best:
                return
            self._best = fit.cost
        self.listener(fit.result)

    def _descend(self, models: PhysicalModels[Any], weights: F, start: F, penalty: float) -> Iterator[tuple[float, F]]:
        layout = models.layout
        problem = BoundedProblem(
            lambda theta: models.error(theta, weights),
            lambda theta: models.normal_equations(theta, weights),
            layout.project,
            layout.low,
            layout.high,
            layout.penalty_weight(penalty) / layout.scale**2,
            layout.start,
        )
        values: list[float] = []
        for value, theta in descend_within_bounds(problem, start):
            yield value, theta
            values.append(value)
            still = len(values) > WINDOW and values[-1] > (1.0 - WINDOW * MIN_GAIN) * values[-1 - WINDOW]
            if still or len(values) >= MAX_STEPS or self._find_stop_reason():
                return

    def _find_stop_reason(self) -> str:
        return reason_to_end(self.limits, self._best, self._deadline, self.stop)

    def _sorted(self) -> list[PhysicalFit]:
        return sorted(self._found, key=lambda fit: fit.cost)
