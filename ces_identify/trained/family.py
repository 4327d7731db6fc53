"""Models of one structure and size, as parameter vectors that a simulation-error fit can change."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ces_identify.numerics.arrays import F, I
from ces_identify.trained.lagged_kernels import RegressorTable, lagged_free_run, lagged_normal_equations
from ces_identify.trained.lagged_table import regressor_table
from ces_identify.trained.training import Training
from ces_observer.model import Model, Sampling
from ces_observer.structures.lagged_signals import Regressor
from ces_observer.structures.structure import Structure


@dataclass(frozen=True)
class Family(ABC):
    """Models on `regressors`, fitted to `training`; `params` is always the vector (parameters,) of one model."""

    training: Training
    regressors: tuple[Regressor, ...]

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of units or rules."""

    @abstractmethod
    def start(self, random: np.random.Generator) -> F:
        """Return random parameters from which a descent starts."""

    @abstractmethod
    def errors_on(self, table: RegressorTable, params: F, max_error: float) -> tuple[float, F, F]:
        """Return the regularised squared error (infinite above `max_error`), its matrix and its gradient."""

    @abstractmethod
    def gains(self, params: F) -> tuple[F, F]:
        """Return upper bounds (n,) of the gain of the past forces and their gradients (n, parameters)."""

    @abstractmethod
    def body(self, params: F) -> Structure:
        """Return the structure with these parameters."""

    @abstractmethod
    def kernel_arrays(self, params: F) -> Any:
        """Return the parameters as the NamedTuple that the kernels take."""

    @cached_property
    def table(self) -> RegressorTable:
        """The regressors over the training ticks."""
        t = self.training
        return regressor_table(self.regressors, t.envelope, t.inputs, t.segments)

    @cached_property
    def past(self) -> I:
        """Indices of the regressors that are past forces."""
        return np.flatnonzero(self.table.past_lags)

    def errors(self, params: F, max_error: float) -> tuple[float, F, F]:
        """Return the errors of the free run, as `errors_on` does."""
        return self.errors_on(self.table, params, max_error)

    def normal_equations(self, table: RegressorTable, params: F, max_error: float) -> tuple[float, F, F]:
        """Return the errors without regularisation."""
        t = self.training
        error, matrix, gradient = lagged_normal_equations(
            table, t.segments, self.kernel_arrays(params), *t.loose, t.measured, t.estimation, max_error
        )
        return error, matrix, gradient

    def force(self, params: F) -> F:
        """Return the free run (ticks,) [N], NaN from where it left the force envelope."""
        t = self.training
        force, _ = lagged_free_run(self.table, t.segments, self.kernel_arrays(params), *t.force_envelope)
        return np.asarray(force)

    def model(self, params: F, sampling: Sampling) -> Model:
        """Return the model with these parameters."""
        return Model(sampling, self.body(params), self.training.envelope, self.training.force_envelope)
