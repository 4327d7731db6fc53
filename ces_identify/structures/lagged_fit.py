"""From prepared series to a trained model: regressors, starts, and the proof; the same for every family of models."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ces_identify.polynomial.limits import Listener
from ces_identify.preparation.series import Series
from ces_identify.structures.kit import Fitted, IdentifyOptions
from ces_identify.trained.simulation_error import Family, train
from ces_identify.trained.training import SIGNALS, Training, build_training
from ces_observer.errors import CesError
from ces_observer.model import Model, Sampling
from ces_observer.structures.lagged_signals import Regressor

MIN_CHANGE = 1e-3  # of a signal, relative: less is a constant, and no regressor


@dataclass(frozen=True)
class Lags:
    """Which regressors to use: lags of past forces [ticks], and delays of the inputs [s], made whole ticks."""

    force: tuple[int, ...] = (1,)
    speed_s: tuple[float, ...] = (0.0, 0.003)
    current_s: tuple[float, ...] = (0.008,)
    position_s: tuple[float, ...] = ()


LAGS = Lags()


def fit_family(
    structure: str,
    make: Callable[[Training, float], Family],
    series: Sequence[Series],
    sampling: Sampling,
    options: IdentifyOptions,
    listener: Listener,
) -> Fitted:
    """Return the best model of a family, which `make` makes of what it is fitted to and its rate [Hz].

    Rules and most terms of the options do not apply. Raises CesError, naming the `structure`, if there is no model.
    """
    family = make(build_training(series, options.weighting), sampling.rate_Hz)
    found = train(family, options.limits, options.certify, listener)
    if not found:
        raise CesError(f"no start of the {structure} fit gave a stable model: give more time, more starts or more data")
    model = family.model(found[0].coefficients, sampling)
    how = {
        "method": "Levenberg-Marquardt on the free-run error, stopped early",
        "parameters": len(found[0].coefficients),
    }
    return Fitted(_certified(model) if options.certify else model, found, how)


def build_regressors(data: Training, lags: Lags, rate_Hz: float) -> tuple[Regressor, ...]:
    """Return the scaled regressors, those of signals that do not change left out."""
    delays = {"speed": lags.speed_s, "current": lags.current_s, "position": lags.position_s}
    chosen = [("force", lag) for lag in lags.force]
    for signal, seconds in delays.items():
        if signal in find_changing_inputs(data):
            chosen += [(signal, lag) for lag in dict.fromkeys(round(s * rate_Hz) for s in seconds)]
    return tuple(data.regressor(signal, lag) for signal, lag in chosen)


def find_changing_inputs(data: Training) -> set[str]:
    """Return the inputs that are not constant."""
    spans = {name: (np.ptp(row), np.abs(row).max()) for name, row in zip(SIGNALS, data.inputs, strict=True)}
    return {name for name, (span, size) in spans.items() if span > MIN_CHANGE * max(1e-9, size)}


def _certified(model: Model) -> Model:
    certificate = model.certify()
    if not certificate.holds:
        raise CesError("the model found could not be proved stable; give --no-certificate")
    return replace(model, certificate=certificate.to_mapping())
