"""Identification of sigmoid networks and neuro-fuzzy models from end to end: recordings in, a model with its costs out.

As `ces_identify.identify` does for polynomials: sampling from the positions, preparation, fit on the estimation ticks,
choice on the selection ticks, proof, evaluation on what neither has seen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ces_identify.identify import Identified, Options, judged
from ces_identify.polynomial.limits import Listener
from ces_identify.preparation.sampling import choose_sampling
from ces_identify.preparation.series import prepare
from ces_identify.recordings.recording import Recording
from ces_identify.trained.fuzzy_fit import FuzzyFit, Grid
from ces_identify.trained.network_fit import NetworkFit
from ces_identify.trained.simulation_error import Family, train
from ces_identify.trained.training import SIGNALS, Training, training
from ces_observer.errors import CesError
from ces_observer.model import Model
from ces_observer.proof.certificate import certify
from ces_observer.structures.lagged import Regressor

NETWORK, ANFIS = "sigmoid", "anfis"
LEAST_CHANGE = 1e-3  # of a signal, relative: less is a constant, and no regressor


@dataclass(frozen=True)
class Lags:
    """Which regressors to use: lags of past forces [ticks], and delays of the inputs [s], made whole ticks."""

    force: tuple[int, ...] = (1,)
    speed_s: tuple[float, ...] = (0.0, 0.003)
    current_s: tuple[float, ...] = (0.008,)
    position_s: tuple[float, ...] = ()


@dataclass(frozen=True)
class NetworkShape:
    """A sigmoid network's size: units, regressors, and the price of a squared parameter in (J / 100)^2."""

    units: int = 10
    lags: Lags = Lags()
    decay: float = 3e-6


@dataclass(frozen=True)
class FuzzyShape:
    """A neuro-fuzzy model's size: memberships of speed and of current (each combination is a rule), and as above.

    `current_delay_s` is the delay of the current that the rules are chosen by.
    """

    speeds: int = 7
    currents: int = 2
    current_delay_s: float = 0.008
    lags: Lags = Lags()
    decay: float = 3e-6


def identify_network(
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),
    options: Options | None = None,
    listener: Listener = lambda found: None,
    shape: NetworkShape = NetworkShape(),
) -> Identified:
    """Identify a sigmoid network NARX (thesis eq. 3.4) on the first `options.split` of every recording.

    Rules and most terms of the options do not apply. Raises CesError if the data hold too little.
    """

    def family(data: Training, rate_Hz: float) -> Family:
        return NetworkFit(data, regressors(data, shape.lags, rate_Hz), shape.units, shape.decay)

    return _identify(family, NETWORK, recordings, validation, options or Options(), listener)


def identify_anfis(
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),
    options: Options | None = None,
    listener: Listener = lambda found: None,
    shape: FuzzyShape = FuzzyShape(),
) -> Identified:
    """Identify a neuro-fuzzy model (Jang 1993) on the first `options.split` of every recording.

    Rules and most terms of the options do not apply. Raises CesError if the data hold too little.
    """

    def family(data: Training, rate_Hz: float) -> Family:
        grid = [Grid("speed", 0, shape.speeds)]
        if shape.currents > 1 and "current" in changing(data):
            grid.append(Grid("current", round(shape.current_delay_s * rate_Hz), shape.currents))
        return FuzzyFit(data, regressors(data, shape.lags, rate_Hz), tuple(grid), shape.decay)

    return _identify(family, ANFIS, recordings, validation, options or Options(), listener)


def regressors(data: Training, lags: Lags, rate_Hz: float) -> tuple[Regressor, ...]:
    """Return the scaled regressors, those of signals that do not change left out."""
    delays = {"speed": lags.speed_s, "current": lags.current_s, "position": lags.position_s}
    chosen = [("force", lag) for lag in lags.force]
    for signal, seconds in delays.items():
        if signal in changing(data):
            chosen += [(signal, lag) for lag in dict.fromkeys(round(s * rate_Hz) for s in seconds)]
    return tuple(data.regressor(signal, lag) for signal, lag in chosen)


def changing(data: Training) -> set[str]:
    """Return the inputs that are not constant."""
    spans = {name: (np.ptp(row), np.abs(row).max()) for name, row in zip(SIGNALS, data.inputs, strict=True)}
    return {name for name, (span, size) in spans.items() if span > LEAST_CHANGE * max(1e-9, size)}


def _identify(
    make: Callable[[Training, float], Family],
    structure: str,
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    options: Options,
    listener: Listener,
) -> Identified:
    seen_positions = [recording.opening(options.split) for recording in recordings]
    sampling = choose_sampling(seen_positions, options.rate_Hz, options.bandwidth_Hz)
    whole = [prepare(recording, sampling) for recording in recordings]
    seen = [series.part(0.0, options.split) for series in whole]
    family = make(training(seen, options.weighting), sampling.rate_Hz)
    found = train(family, options.limits, options.certify, listener)
    if not found:
        raise CesError(f"no start of the {structure} fit gave a stable model: give more time, more starts or more data")
    model = _proved(family.model(found[0].coefficients, sampling), options.certify)
    how = {
        "method": "Levenberg-Marquardt on the free-run error, stopped early",
        "parameters": len(found[0].coefficients),
    }
    return judged(model, found, how, (recordings, whole), validation, options)


def _proved(model: Model, prove: bool) -> Model:
    if not prove:
        return model
    certificate = certify(model)
    if not certificate.holds:
        raise CesError("the model found could not be proved stable; give --no-certificate")
    return replace(model, certificate=certificate.to_mapping())
