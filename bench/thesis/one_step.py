"""Networks and neuro-fuzzy models trained the conventional way, without a proof or a bound on the force.

Networks are trained on the error one step ahead (series-parallel), as MATLAB's `nlarx` does by default: measured past
forces replace the model's own, which makes the fit an ordinary nonlinear least-squares problem but does not control the
free run; the same holds for a polynomial's least squares. Neuro-fuzzy models of present inputs have no past forces, and
so only one kind of error. Parameters are selected by free run on the selection ticks, as in the thesis for polynomials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ces_identify.polynomial.search_limits import Limits
from ces_identify.preparation.sampling import choose_sampling
from ces_identify.preparation.series import prepare
from ces_identify.recordings.recording import Recording
from ces_identify.structures.fuzzy import FuzzyShape
from ces_identify.structures.network import NetworkShape
from ces_identify.trained.lagged_kernels import RegressorTable
from ces_identify.trained.lagged_table import delay_values
from ces_identify.trained.network_fit import NetworkFit
from ces_identify.trained.simulation_error import train
from ces_identify.trained.training import Training, build_training
from ces_observer.errors import CesError
from ces_observer.model import Model

F = NDArray[np.float64]


class OneStepNetwork(NetworkFit):
    """A sigmoid network whose errors are those of one step."""

    @cached_property
    def measured_table(self) -> RegressorTable:
        """The regressors, past forces among them as measured."""
        return with_measured_past(self.table, self.training)

    def errors(self, params: F, max_error: float) -> tuple[float, F, F]:
        """Return the squared one-step error with the penalty on decay, its matrix and its gradient."""
        return self.errors_on(self.measured_table, params, max_error)


def with_measured_past(table: RegressorTable, data: Training) -> RegressorTable:
    """Return the regressors with measured forces instead of the model's own past forces."""
    values = table.values.copy()
    for j in np.flatnonzero(table.past_lags):
        past = delay_values(data.measured, int(table.past_lags[j]), data.segments)
        values[:, j] = (past - table.past_means[j]) / table.past_spreads[j]
    return table._replace(values=values, past_lags=np.zeros_like(table.past_lags))


def fit_conventionally(shape: NetworkShape | FuzzyShape, recordings: Sequence[Recording], limits: Limits) -> Model:
    """Return a model of this shape; raises CesError if every start's free run diverged."""
    sampling = choose_sampling(recordings)
    data = build_training([prepare(recording, sampling) for recording in recordings])
    family = shape.family(replace(data, force_envelope=data.loose), sampling.rate_Hz)
    if isinstance(family, NetworkFit):
        family = OneStepNetwork(*(getattr(family, f.name) for f in fields(family)))
    results = train(family, limits, certify=False)
    if not results:
        raise CesError(f"every free run of {shape.option} models diverged")
    return family.model(results[0].coefficients, sampling)
