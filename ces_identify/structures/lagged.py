"""What networks and neuro-fuzzy models share at the desk: the fit.

Without given lags, short fits of small models choose among LAG_SETS, and whether the stroke belongs to the inputs.

A fit has starts: Levenberg-Marquardt on the free run, stopped early. Every start climbs a ladder of sizes: at each it
descends on the estimation ticks from random parameters, and from the best smaller model if that is not enough to beat
it. It keeps the parameters with the lowest cost on the selection ticks, whatever their size. With `certificate`, a
descent begins free, and penalties lead the gain of the past forces below a limit by stages; only parameters below it
are kept.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from math import inf
from typing import ClassVar, Self

import numpy as np

from ces_data.arrays import F
from ces_identify.limits import ChoiceLimits, StabilityLimits
from ces_identify.numerics.least_squares import descend, limit_gains
from ces_identify.numerics.search import (
    INTERRUPTED,
    NO_MORE_GAIN,
    WORK_IS_DONE,
    Limits,
    Listener,
    SearchResult,
    SearchStart,
    clock_s,
    run_starts,
    spread_work,
)
from ces_identify.prepare.series import Series
from ces_identify.structures.kit import Fitted, IdentifyOptions, require_models
from ces_identify.training import LAG_SETS, Family, LagCounts, Lags, Training, build_training
from ces_observer.errors import CesError, OptionName
from ces_observer.model import Model, Sampling
from ces_observer.proof.certificate import largest_gain
from ces_observer.structures.lagged_signals import longest_lags

REFIT_STEPS = 4  # trial steps of Levenberg-Marquardt
LAG_SHARE = 0.15  # of the time that is left, for each fit that chooses lags
LAG_WORK, LAG_SIZE = 0.03, 6  # of a fit that chooses lags: share of the work of a start, units or rules at most
STROKE_WORK, STROKE_SIZE = 0.1, 20  # of a fit that shows whether the stroke counts


PENALTY_MARGIN = 0.002  # below the greatest gain, where the penalty begins
PENALTIES = (10.0, 100.0, 1e3, 1e4)  # [(J / 100)^2] on a squared excess of gain, raised until there is no excess
# A descent begins free, ended after FREE_PATIENCE steps without improvement. Limits then fall from its gain, at most
# FIRST_LIMIT times the last one, in STAGES of a small penalty: on keio and shaking_table J is 20 % lower than straight
FREE_PATIENCE, FIRST_LIMIT, STAGES, STAGE_PENALTY, STAGE_PATIENCE = 15, 3.0, 6, 1.0, 6
WORK = 1.2e11  # of a start: ticks times squared parameters, of all steps
MAX_STEPS = 300  # of a descent
PATIENCE = 25  # steps without improvement on the selection ticks, after which the last one ends
MIN_IMPROVEMENT = 1e-3  # relative
NO_STEP, DIVERGED = "no step lowers the error", "start diverged"
GOES_ON = (NO_MORE_GAIN, NO_STEP, DIVERGED)  # ends of a descent, after which the start climbs on


class LaggedShape(ABC):
    """The size of a structure on lagged regressors. A call fits models of this size; it is a `Fitter`.

    Subclasses have `lags`, None if the data choose them.
    """

    option: ClassVar[str]
    lags: Lags | LagCounts | None

    @abstractmethod
    def with_inputs(self, lags: Lags | LagCounts, stroke: bool) -> Self:
        """Return the shape with these lags, and with the stroke among the inputs."""

    @abstractmethod
    def family(self, data: Training, rate_Hz: float) -> Family:
        """Return the models of this size for the data."""

    def __call__(
        self, series: Sequence[Series], sampling: Sampling, options: IdentifyOptions, listener: Listener
    ) -> Fitted:
        """Return the best model; raises CesError if no start gives one. Rules and limits on terms do not apply."""
        end_s, data = clock_s() + options.limits.time, build_training(series, options.weight)
        listener(f"choosing the inputs of the {self.option}")
        shape = self if self.lags is not None else self._choose_lags(data, sampling.rate_Hz, options, end_s)
        family = shape.family(data, sampling.rate_Hz)
        gain = largest_gain(options.forget, *longest_lags(family.columns), sampling.rate_Hz)
        listener(f"training the {self.option}")
        results = train(
            family, options.limits.within(end_s), options.certificate, listener, min(StabilityLimits.MAX_GAIN, gain)
        )
        require_models(results, self.option)
        params = results[0].coefficients
        family = next(rung for rung in family.ladder() if rung.size == len(results[0].chosen))
        model = family.model(params, sampling)
        if options.certificate:
            listener("proving stability")
            certificate = model.certify()
            if not certificate.holds:
                advice = "try other sizes or give "
                raise CesError(f"the model could not be proved stable; {advice}", OptionName("certificate", False))
            model = replace(model, certificate=certificate.to_mapping())
        how = {"method": "Levenberg-Marquardt on the free-run error, stopped early", "parameters": len(params)}
        return Fitted(model, results, how, partial(_refit, family, params, sampling))

    def _choose_lags(self, data: Training, rate_Hz: float, options: IdentifyOptions, end_s: float) -> Self:
        def cost(lags: Lags | LagCounts, stroke: bool, work: float, size: int) -> float:
            smallest, *larger = self.with_inputs(lags, stroke).family(data, rate_Hz).ladder()
            family = [smallest, *(rung for rung in larger if rung.size <= size)][-1]
            within = options.limits.within(end_s, LAG_SHARE)
            limits = replace(within, starts=1, threads=1, target=0.0, work=work)
            results = train(family, limits, options.certificate)
            if any(result.ended == INTERRUPTED for result in results):
                raise KeyboardInterrupt
            return results[0].cost if results else inf

        lags = LAG_SETS[int(np.argmin([cost(lag_set, False, LAG_WORK, LAG_SIZE) for lag_set in LAG_SETS]))]
        plain, deeper = (cost(lags, stroke, STROKE_WORK, STROKE_SIZE) for stroke in (False, True))
        counts = "position" in data.changing_inputs() and deeper < ChoiceLimits.STROKE_GAIN * plain
        return self.with_inputs(lags, counts)


def _refit(family: Family, params: F, sampling: Sampling, weights: F) -> Model | None:
    """Return the model with parameters fitted to the weighted ticks, as `Fitted.refit` describes it."""
    data = family.training
    weighted = replace(family, training=replace(data, estimation=weights * data.everything))
    for point in islice(descend(weighted.equations, params, [weighted.pull]), REFIT_STEPS):
        params = point.params
    return weighted.model(params, sampling)


def train(
    family: Family,
    limits: Limits,
    certificate: bool = True,
    listener: Listener = lambda result: None,
    max_gain: float = StabilityLimits.MAX_GAIN,
) -> list[SearchResult]:
    """Run the starts in parallel threads and return their results, best first, without starts that failed.

    Ctrl-C stops every start; the best results so far are returned. The threads call `listener` at each improvement and
    when a start stops. `SearchResult.chosen` counts units or rules, which tells the model of the family's ladder;
    `coefficients` are its parameters.
    """
    limits = spread_work(limits, len(family.training.measured))
    results = run_starts(limits, listener, lambda start: _Climb(family, start, certificate, max_gain).run())
    return [result for result in results if np.isfinite(result.cost)]


@dataclass
class _Climb:
    """One start on its way up the ladder; `family` is that of the present size."""

    family: Family
    start: SearchStart
    certificate: bool
    max_gain: float
    step: int = 0
    spent: float = 0.0  # share of the work
    lowest: float = np.inf  # selection cost of the last real improvement,
    improved_at: int = 0  # and its step
    began_at: int = 0  # step of the present descent,
    patience: int = PATIENCE  # and steps without improvement after which it ends

    def run(self) -> SearchResult:
        """Descend at each size until the cost on the selection ticks stops falling; return the best parameters."""
        ended, ladder, start = self._find_stop_reason(), self.family.ladder(), self.start
        for family in ladder:
            if ended in ("", *GOES_ON):
                self.family = family
                ended = self._descend(family.start(start.random))
            smaller = next((rung for rung in ladder if rung.size == len(start.best.chosen)), family)
            if ended in GOES_ON and smaller.size < family.size:
                ended = self._descend(family.grow(smaller, start.best.coefficients, start.random))
        if np.isfinite(start.best.cost):
            start.keep(ended=ended, share=1.0)
        return start.best

    def _descend(self, params: F) -> str:
        """Descend without a limit on the gain, then under limits that fall to `max_gain`; return why it ended."""
        if not self.certificate:
            return self._descend_under(np.inf, 0.0, PATIENCE, params)[1] or NO_STEP
        params, ended = self._descend_under(np.inf, 0.0, FREE_PATIENCE, params)
        excess = np.clip(self.family.gains(params)[0].max() / self.max_gain, 1.0, FIRST_LIMIT)
        stages = [
            (self.max_gain * excess ** (1.0 - k / STAGES), STAGE_PENALTY, STAGE_PATIENCE) for k in range(1, STAGES)
        ]
        for limit, penalty, patience in (*stages, *((self.max_gain, strength, PATIENCE) for strength in PENALTIES)):
            if ended not in ("", NO_MORE_GAIN) or (penalty > PENALTIES[0] and self._is_allowed(params)):
                break
            params, ended = self._descend_under(limit, penalty, patience, params)
        return ended or NO_STEP

    def _descend_under(self, limit: float, penalty: float, patience: int, params: F) -> tuple[F, str]:
        """Descend with a penalty on gains above a limit; return the parameters, and why it ended, '' without a step."""
        ended, self.patience = DIVERGED, patience
        self.lowest, self.improved_at, self.began_at = np.inf, self.step, self.step
        penalties = [self.family.pull]
        if penalty:
            gains = self.family.gains
            how = (lambda at: gains(at)[0]), (lambda at, above: gains(at)[1][above])
            penalties.append(limit_gains(*how, limit - PENALTY_MARGIN, penalty))
        for point in descend(self.family.equations, params, penalties):
            if point.params is not params or self.step == self.began_at:
                self._evaluate(point.params)
            params = point.params
            self.step += 1
            self.spent += (
                len(self.family.training.measured) * len(params) ** 2 / max(1.0, WORK * self.start.limits.work)
            )
            ended = self._find_stop_reason()
            if ended:
                break
        return params, ended

    def _evaluate(self, params: F) -> None:
        cost = self.family.training.cost(self.family.force(params), self.family.training.selection)
        if cost < self.lowest * (1.0 - MIN_IMPROVEMENT):
            self.lowest, self.improved_at = cost, self.step
        if cost < self.start.best.cost and self._is_allowed(params):
            chosen, share = np.arange(self.family.size), min(1.0, self.spent)
            self.start.keep(chosen=chosen, coefficients=params, cost=cost, trials=self.step + 1, share=share)

    def _find_stop_reason(self) -> str:
        reason = self.start.reason_to_end()
        if reason or self.spent >= 1.0:
            return reason or WORK_IS_DONE
        still = self.step - self.improved_at >= self.patience or self.step - self.began_at >= MAX_STEPS
        return NO_MORE_GAIN if still else ""

    def _is_allowed(self, params: F) -> bool:
        return not self.certificate or bool(self.family.gains(params)[0].max() < self.max_gain)
