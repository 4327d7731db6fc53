"""What networks and neuro-fuzzy models share at the desk: the fit.

Without given lags, short fits of small models choose among LAG_SETS, and whether the stroke belongs to the inputs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from math import inf
from typing import ClassVar, Self

import numpy as np

from ces_data.arrays import F
from ces_identify.numerics.levenberg import descend
from ces_identify.polynomial.search_limits import INTERRUPTED, Listener
from ces_identify.prepare.series import Series
from ces_identify.structures.kit import Fitted, IdentifyOptions
from ces_identify.trained.starts import train
from ces_identify.trained.training import LAG_SETS, MAX_GAIN, Family, LagCounts, Lags, Training, build_training
from ces_observer.errors import CesError
from ces_observer.model import Model, Sampling
from ces_observer.proof.certificate import largest_gain
from ces_observer.structures.lagged_signals import longest_lags

REFIT_STEPS = 4  # trial steps of Levenberg-Marquardt
LAG_WORK, LAG_SIZE = 0.03, 6  # of a fit that chooses lags: share of the work of a start, units or rules at most
STROKE_WORK, STROKE_SIZE = 0.1, 20  # of a fit that shows whether the stroke counts
STROKE_GAIN = 0.92  # share of the selection cost below which it does


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
        data = build_training(series, options.weight)
        shape = self if self.lags is not None else self._choose_lags(data, sampling.rate_Hz, options)
        family = shape.family(data, sampling.rate_Hz)
        gain = largest_gain(options.forget, *longest_lags(family.columns), sampling.rate_Hz)
        results = train(family, options.limits, options.certificate, listener, min(MAX_GAIN, gain))
        if not results:
            raise CesError(f"no start of the {self.option} fit gave a stable model; give more starts or data")
        params = results[0].coefficients
        family = next(one for one in family.ladder() if one.size == len(results[0].chosen))
        model = family.model(params, sampling)
        if options.certificate:
            certificate = model.certify()
            if not certificate.holds:
                raise CesError("the model could not be proved stable; try other sizes or give --no-certificate")
            model = replace(model, certificate=certificate.to_mapping())
        how = {"method": "Levenberg-Marquardt on the free-run error, stopped early", "parameters": len(params)}
        return Fitted(model, results, how, partial(_refit, family, params, sampling))

    def _choose_lags(self, data: Training, rate_Hz: float, options: IdentifyOptions) -> Self:
        def cost(lags: Lags | LagCounts, stroke: bool, work: float, size: int) -> float:
            first, *larger = self.with_inputs(lags, stroke).family(data, rate_Hz).ladder()
            family = [first, *(one for one in larger if one.size <= size)][-1]
            limits = replace(options.limits, starts=1, threads=1, target=0.0, work=work)
            results = train(family, limits, options.certificate)
            if any(result.ended == INTERRUPTED for result in results):
                raise KeyboardInterrupt
            return results[0].cost if results else inf

        lags = LAG_SETS[int(np.argmin([cost(one, False, LAG_WORK, LAG_SIZE) for one in LAG_SETS]))]
        plain, deeper = (cost(lags, stroke, STROKE_WORK, STROKE_SIZE) for stroke in (False, True))
        return self.with_inputs(lags, "position" in data.changing_inputs() and deeper < STROKE_GAIN * plain)


def _refit(family: Family, params: F, sampling: Sampling, weights: F) -> Model | None:
    """Return the model with parameters fitted to the weighted ticks, as `Fitted.refit` describes it."""
    data = family.training
    weighted = replace(family, training=replace(data, estimation=weights * (data.estimation + data.selection)))
    *_, (_, params) = ((0.0, params), *islice(descend(weighted.errors, params), REFIT_STEPS))
    return weighted.model(params, sampling)
