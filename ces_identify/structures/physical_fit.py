"""The fit of structures with the physics inside: from prepared series to a model with its certificate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Protocol

import numpy as np

from ces_identify.numerics.arrays import F
from ces_identify.physical.common_groups import DataScales, read_scales
from ces_identify.physical.models import PhysicalModels
from ces_identify.physical.physical_search import PhysicalFit, PhysicalSearch
from ces_identify.polynomial.search_limits import Listener
from ces_identify.preparation.series import Series
from ces_identify.structures.kit import Fitted, Fitter, IdentifyOptions
from ces_identify.structures.physical_quantities import ERRORS, describe_errors
from ces_identify.trained.training import Training, build_training
from ces_observer.errors import CesError
from ces_observer.model import Model, Sampling

METHOD = "Levenberg-Marquardt on the free-run error, exact derivatives; penalty and size by the selection data"
AUTO = "auto"


class Sizes(Protocol):
    """Returns the models to fit, the smallest first, larger ones to try after it."""

    def __call__(self, training: Training, scales: DataScales) -> Sequence[PhysicalModels]:
        """Return the models of all sizes."""


def physical_fitter(option: str, sizes: Sizes) -> Fitter:
    """Return the fitter of a structure.

    With one start it is short: one size, one strength of the penalty, no standard errors.
    """

    def fit(series: Sequence[Series], sampling: Sampling, options: IdentifyOptions, listener: Listener) -> Fitted:
        training = build_training(series, options.weighting)
        smallest, *larger = sizes(training, read_scales(training, sampling.rate_Hz))
        search = PhysicalSearch(options.limits, listener)
        short = options.limits.starts == 1
        fits = search.run(smallest, larger, short)
        if not fits:
            raise CesError(f"no start of the {option} fit gave a finite cost; check signals and units")
        theta = search.refit(fits[0])
        how: dict[str, Any] = {
            "method": METHOD,
            "parameters": len(theta),
            "penalty": fits[0].penalty,
        }
        if not short:
            how[ERRORS] = describe_errors(fits[0].models, theta, fits[0].penalty)
        best = replace(fits[0], theta=theta)
        return Fitted(
            _model(best, sampling),
            [one.result for one in fits],
            how,
            partial(_refit, search, best, sampling),
            leave_out_recordings=False,
        )

    return fit


def _refit(search: PhysicalSearch, best: PhysicalFit, sampling: Sampling, weights: F) -> Model:
    """Return the model after a few more steps on the ticks with a weight; the time limit applies to each refit anew."""
    theta = PhysicalSearch(search.limits, lambda result: None).refit(best, weights)
    return _model(replace(best, theta=theta), sampling)


def _model(fit: PhysicalFit, sampling: Sampling) -> Model:
    """Return the model; its force envelope holds its proved bound, so that it never leaves it."""
    training = fit.models.training
    model = Model(sampling, fit.models.body(fit.theta), training.envelope, training.force_envelope)
    certificate: Any = model.certify()
    if not certificate.holds or not np.isfinite(certificate.force_bound_N):
        raise CesError("the force of the model could not be bounded; give other data")
    low, high = training.force_envelope
    bound = certificate.force_bound_N
    return replace(
        model,
        force_envelope_N=(min(low, -bound), max(high, bound)),
        certificate=certificate.to_mapping(),
    )
