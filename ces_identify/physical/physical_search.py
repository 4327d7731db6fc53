"""The fit of hydraulic networks: every kind of damper, then how far its curves may leave their laws, then a bypass.

The data's estimation ticks serve the descents (Levenberg-Marquardt on the free run's error, exact derivatives), its
selection ticks the choices. Each kind starts from laws of its valves, whose curves are then freed, as the costs of the
laws alone say little. The best kind goes on with weaker pulls towards usual values, as long as that helps. The work is
counted in steps, so that any machine finds the same model.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import islice

import numpy as np

from ces_data.arrays import F
from ces_identify.limits import ChoiceLimits
from ces_identify.numerics.least_squares import check_error_first, improve, pull_towards
from ces_identify.numerics.search import Limits, Listener, SearchResult, SearchStart
from ces_identify.physical.layout import DataScales
from ces_identify.physical.models import HydraulicModels
from ces_identify.training import Training

LAW_STEPS, NODE_STEPS, LAST_STEPS = 8, 8, 6  # of each of two descents on laws, on nodes, and the last to all ticks
STIFF = 30.0  # in the first, all but the laws is pulled so much more strongly: far from the data it would run away
SHORT_WORK = 0.5  # less than this is a short fit: half of the steps and the share that is its work, nothing more
STRENGTHS = (0.3, 0.03, 0.003, 0.001)  # of the pull towards usual values,
HELD_STRENGTHS = (0.3, 0.1, 0.03)  # and where the current was held
STROKE_NODES = 12
MIN_GAIN = 1e-3  # mean relative fall of the error a step, over WINDOW steps, below which a descent has ended
WINDOW = 4
ENDED = "no step lowers the error"


@dataclass(frozen=True)
class PhysicalFit:
    """Parameters of one network of `models`, its cost on the selection ticks [%], and the pull's strength."""

    models: HydraulicModels
    theta: F
    cost: float
    strength: float
    result: SearchResult


@dataclass
class PhysicalSearch:
    """One search; `stop` or the deadline ends it with the best so far."""

    limits: Limits
    listener: Listener

    def __post_init__(self) -> None:
        self._start = SearchStart(self.limits, self.listener)
        self.stop = self._start.stop
        self._lock = threading.Lock()
        self._trials = 0
        self._fits: list[PhysicalFit] = []

    def run(
        self, training: Training, scales: DataScales, kinds: Sequence[str], rows: int, held: bool
    ) -> list[PhysicalFit]:
        """Return the best fit of each kind, and of what the best of them became, best first, also after Ctrl-C."""
        try:
            make = partial(HydraulicModels.first, training, scales, rows=rows, held=held)
            self._fit_kinds([make(kind=kind) for kind in kinds])
            best = self._sorted()[0] if self._fits else None
            if best and depends_on_stroke(best):
                self._fit_kind(make(kind=best.models.kind, bypass=True), len(kinds))
            if best and self.limits.work >= SHORT_WORK:
                weaker = (HELD_STRENGTHS if held else STRENGTHS)[1:]
                self._weaken(self._sorted()[0], weaker, [NODE_STEPS] * len(weaker))
        except KeyboardInterrupt:
            self.stop.set()
        return self._sorted()

    def polish(
        self, fit: PhysicalFit, training: Training, interval_s: float, strengths: Sequence[float]
    ) -> PhysicalFit:
        """Return the fit continued on other ticks of the same data, `interval_s` apart, with weaker and weaker pulls.

        The last descent has as many steps as that on nodes; the others, which lead to it, half of them.
        """
        models, theta = fit.models.at_interval(training, interval_s, fit.theta)
        steps = [NODE_STEPS // 2] * (len(strengths) - 1) + [NODE_STEPS]
        again = self._fit(models, theta, strengths[0], 0, steps[0])
        return self._weaken(again, strengths[1:], steps[1:])

    def refit(self, fit: PhysicalFit, share: F | float = 1.0) -> F:
        """Return the parameters after a last fit to all ticks, weighted by `share` (ticks,)."""
        everything = fit.models.training.everything * share
        steps = self._descend(fit.models, everything, fit.theta, fit.strength, LAST_STEPS)
        return [fit.theta, *steps][-1]

    def _fit_kinds(self, starts: Sequence[HydraulicModels]) -> None:
        with ThreadPoolExecutor(max(1, self.limits.threads)) as pool:
            runs = [pool.submit(self._fit_kind, models, seed) for seed, models in enumerate(starts)]
            try:
                for run in runs:
                    run.result()
            except KeyboardInterrupt:
                self.stop.set()
                raise

    def _fit_kind(self, models: HydraulicModels, seed: int) -> None:
        if self._fits and self._start.reason_to_end():
            return
        share = min(0.5 + self.limits.work, 1.0)
        estimation = models.training.estimation
        theta = models.layout.centre
        for stiff in (STIFF, 1.0):
            steps = self._descend(models, estimation, theta, STRENGTHS[0], round(share * LAW_STEPS), stiff)
            theta = [theta, *steps][-1]
        self._fit(*models.free(theta), STRENGTHS[0], seed, round(share * NODE_STEPS))

    def _weaken(self, best: PhysicalFit, strengths: Sequence[float], steps: Sequence[int]) -> PhysicalFit:
        """Return the fit continued with weaker and weaker pulls, as long as that helps."""
        for strength, count in zip(strengths, steps, strict=True):
            weaker = self._fit(best.models, best.theta, strength, 0, count)
            if weaker.cost > ChoiceLimits.WEAKER_PULL * best.cost:
                break
            best = weaker
        return best

    def _fit(self, models: HydraulicModels, start: F, strength: float, seed: int, steps: int) -> PhysicalFit:
        """Return the parameters with the lowest selection cost of one descent; keep them if it is finite."""
        training = models.training
        best = self._as_fit(models, start, models.cost(start, training.selection), strength, seed)
        try:
            for theta in self._descend(models, training.estimation, start, strength, steps):
                cost = models.cost(theta, training.selection)
                if cost < best.cost:
                    best = self._as_fit(models, theta, cost, strength, seed)
                    self._report(best)
        finally:
            best = self._as_fit(models, best.theta, best.cost, strength, seed, self._start.reason_to_end() or ENDED)
            if np.isfinite(best.cost):
                self._fits.append(best)
        self.listener(best.result)
        return best

    def _as_fit(
        self, models: HydraulicModels, theta: F, cost: float, strength: float, seed: int, ended: str = "running"
    ) -> PhysicalFit:
        result = SearchResult(np.arange(len(theta)), theta, cost, self.limits.seed + seed, self._trials, ended)
        return PhysicalFit(models, theta, cost, strength, result)

    def _report(self, fit: PhysicalFit) -> None:
        with self._lock:
            self._trials += 1
            if fit.cost >= self._start.best.cost:
                return
            self._start.best = fit.result
        self.listener(fit.result)

    def _descend(
        self, models: HydraulicModels, weights: F, start: F, strength: float, steps: int, stiff: float = 1.0
    ) -> Iterator[F]:
        if self._start.reason_to_end():
            return
        pull = strength * models.layout.weight
        pull[: sum(len(group.centre) for group in models.layout.groups)] *= stiff
        equations = check_error_first(
            lambda theta: models.error(theta, weights), lambda theta: models.normal_equations(theta, weights)
        )
        values: list[float] = []
        for point in islice(improve(equations, start, [pull_towards(models.layout.centre, pull)]), 1, None):
            yield point.params
            values.append(point.value)
            still = len(values) > WINDOW and values[-1] > (1.0 - WINDOW * MIN_GAIN) * values[-1 - WINDOW]
            if still or len(values) >= steps or self._start.reason_to_end():
                return

    def _sorted(self) -> list[PhysicalFit]:
        return sorted(self._fits, key=lambda fit: fit.cost)


def depends_on_stroke(fit: PhysicalFit) -> bool:
    """Return whether the error of a fit follows the stroke as a bypass would make it, as a share of the force."""
    training = fit.models.training
    weights = np.sqrt(training.estimation)
    force, position = fit.models.force(fit.theta), training.inputs[0]
    nodes = np.linspace(fit.models.scales.positions_m[0], fit.models.scales.positions_m[-1], STROKE_NODES)
    hats = np.stack([np.interp(position, nodes, hat) for hat in np.eye(STROKE_NODES)], axis=1)
    plain = np.stack([np.ones_like(force), force, training.inputs[1]], axis=1)
    error = weights * (training.measured - force)
    shares = []
    for features in (plain, np.hstack([plain, hats * force[:, None]])):
        scaled = weights[:, None] * features
        unexplained = error - scaled @ np.linalg.lstsq(scaled, error, rcond=None)[0]
        shares.append(float(unexplained @ unexplained))
    return shares[1] < (1.0 - ChoiceLimits.BYPASS_SHARE) * shares[0]
