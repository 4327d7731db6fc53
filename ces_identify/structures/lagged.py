"""What networks and neuro-fuzzy models share at the desk: the fit, and the lagged regressors of their C."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import ClassVar

from ces_data.arrays import F
from ces_identify.numerics.levenberg import descend
from ces_identify.polynomial.search_limits import Listener
from ces_identify.prepare.series import Series
from ces_identify.structures.kit import ARGUMENTS, Fitted, IdentifyOptions
from ces_identify.trained.training import Family, Training, build_training, train
from ces_observer.errors import CesError
from ces_observer.model import Model, Sampling
from ces_observer.structures.lagged_signals import Regressor

REFIT_STEPS = 4  # trial steps of Levenberg-Marquardt


@dataclass(frozen=True)
class LaggedShape(ABC):
    """The size of a structure on lagged regressors. A call fits models of this size; it is a `Fitter`."""

    option: ClassVar[str]

    @abstractmethod
    def family(self, data: Training, rate_Hz: float) -> Family:
        """Return the models of this size for the data."""

    def __call__(
        self, series: Sequence[Series], sampling: Sampling, options: IdentifyOptions, listener: Listener
    ) -> Fitted:
        """Return the best model; raises CesError if no start gives one. Rules and limits on terms do not apply."""
        family = self.family(build_training(series, options.weight), sampling.rate_Hz)
        results = train(family, options.limits, options.certificate, listener)
        if not results:
            raise CesError(f"no start of the {self.option} fit gave a stable model; give more time, starts or data")
        params = results[0].coefficients
        model = family.model(params, sampling)
        if options.certificate:
            certificate = model.certify()
            if not certificate.holds:
                raise CesError("the model could not be proved stable; try other sizes or give --no-certificate")
            model = replace(model, certificate=certificate.to_mapping())
        how = {"method": "Levenberg-Marquardt on the free-run error, stopped early", "parameters": len(params)}
        return Fitted(model, results, how, partial(_refit, family, params, sampling))


def _refit(family: Family, params: F, sampling: Sampling, weights: F) -> Model | None:
    """Return the model with parameters fitted to the weighted ticks, as `Fitted.refit` describes it."""
    data = family.training
    weighted = replace(family, training=replace(data, estimation=weights * (data.estimation + data.selection)))
    *_, (_, params) = ((0.0, params), *islice(descend(weighted.errors, params), REFIT_STEPS))
    return weighted.model(params, sampling)


def lagged_facts(regressors: Iterable[Regressor], lags: Iterable[tuple[str, int]], model: Model) -> dict[str, object]:
    """Return regressors, inputs and the rings of `lags` (signal, ticks back), sized to powers of two, 0 if unused."""
    rings: dict[str, int] = {}
    for signal, lag in lags:
        rings[signal] = max(1 << lag.bit_length(), rings.get(signal, 0))
    ranges = model.envelope.by_signal
    return {
        "regressors": tuple(regressors),
        "rings": rings,
        "inputs": [
            {"name": name, "argument": argument, "range": ranges[name], "ring": rings.get(name, 0)}
            for name, argument in ARGUMENTS.items()
        ],
    }
