"""The fit of networks and neuro-fuzzy models: from prepared series to a model with its certificate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from ces_identify.polynomial.limits import Listener
from ces_identify.preparation.series import Series
from ces_identify.structures.kit import Fitted, IdentifyOptions
from ces_identify.trained.family import Family
from ces_identify.trained.simulation_error import train
from ces_identify.trained.training import Training, build_training
from ces_observer.errors import CesError
from ces_observer.model import Model, Sampling


def fit_family(
    structure: str,
    build_family: Callable[[Training, float], Family],
    series: Sequence[Series],
    sampling: Sampling,
    options: IdentifyOptions,
    listener: Listener,
) -> Fitted:
    """Return the best model of the family that `build_family` returns for the training data and the rate [Hz].

    Rules and limits on terms do not apply. Raises CesError, naming the `structure`, if no start gives a model.
    """
    family = build_family(build_training(series, options.weighting), sampling.rate_Hz)
    results = train(family, options.limits, options.certify, listener)
    if not results:
        raise CesError(f"no start of the {structure} fit gave a stable model; give more time, more starts or more data")
    model = family.model(results[0].coefficients, sampling)
    how = {
        "method": "Levenberg-Marquardt on the free-run error, stopped early",
        "parameters": len(results[0].coefficients),
    }
    return Fitted(_certified(model) if options.certify else model, results, how)


def _certified(model: Model) -> Model:
    certificate = model.certify()
    if not certificate.holds:
        raise CesError("the model could not be proved stable; try other sizes or give --no-certificate")
    return replace(model, certificate=certificate.to_mapping())
