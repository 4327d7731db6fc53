"""A sigmoid network as a simulation-error fit sees it: starts, errors with their derivatives, and its gain."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ces_identify.numerics.arrays import F, I
from ces_identify.trained.lagged_kernels import RegressorTable, lagged_free_run, lagged_normal_equations
from ces_identify.trained.lagged_table import regressor_table
from ces_identify.trained.network_kernels import NetworkArrays
from ces_identify.trained.training import Training
from ces_observer.model import Model, Sampling
from ces_observer.structures.lagged_signals import Regressor
from ces_observer.structures.network import Network, SigmoidUnit

FIRST_GAIN = 0.9  # of past forces together, in a start
FIRST_SLOPE = 1.5  # spread of a start's slopes, all inputs together
FIRST_WEIGHT = 0.05
STEEPEST_SLOPE = 0.25  # of a sigmoid
KINK = 5e-4  # part of a unit in the gain, below which the bound's kink is rounded off


@dataclass(frozen=True)
class NetworkFit:
    """Networks of `units` sigmoids on `regressors`, as parameter vectors (see network_kernels).

    `decay` is the price of a squared parameter, in (J / 100)^2.
    """

    training: Training
    regressors: tuple[Regressor, ...]
    units: int
    decay: float

    @property
    def size(self) -> int:
        """Number of units."""
        return self.units

    @cached_property
    def table(self) -> RegressorTable:
        """The regressors over the training ticks."""
        t = self.training
        return regressor_table(self.regressors, t.envelope, t.inputs, t.segments)

    @cached_property
    def past(self) -> I:
        """Indices of the regressors that are past forces."""
        return np.flatnonzero(self.table.past_lags)

    def start(self, random: np.random.Generator) -> F:
        """Return random parameters: a slow affine past, and units that see the inputs only."""
        r = len(self.regressors)
        linear, units = np.zeros(r), random.normal(0.0, FIRST_SLOPE / np.sqrt(r), (self.units, 2 + r))
        linear[self.past] = FIRST_GAIN / max(1, len(self.past))
        units[:, 0] = random.normal(0.0, FIRST_WEIGHT, self.units)
        units[:, 1] = random.normal(0.0, 1.0, self.units)
        units[:, 2 + self.past] = 0.0
        constant = (1.0 - linear.sum()) * self.training.level
        return np.concatenate([[constant], linear, units.ravel()])

    def errors(self, params: F, max_error: float) -> tuple[float, F, F]:
        """Return the squared error on the estimation ticks with the price of decay, its matrix and its gradient."""
        return self.errors_on(self.table, params, max_error)

    def errors_on(self, table: RegressorTable, params: F, most: float) -> tuple[float, F, F]:
        """Return the errors on these regressors."""
        t = self.training
        error, matrix, gradient = lagged_normal_equations(
            table, t.segments, self._arrays(params), *t.loose, t.measured, t.estimation, most
        )
        matrix[np.diag_indices_from(matrix)] += self.decay
        return error + self.decay * float(params @ params), matrix, gradient - self.decay * params

    def force(self, params: F) -> F:
        """Return the free run [N] over the training ticks, NaN where it left the force envelope."""
        t = self.training
        force, _ = lagged_free_run(self.table, t.segments, self._arrays(params), *t.force_envelope)
        return np.asarray(force)

    def _arrays(self, params: F) -> NetworkArrays:
        return NetworkArrays(self.training.scale_N, params, self.units)

    def gains(self, params: F) -> tuple[F, F]:
        """Return a bound (1,) on the gain of past forces and its gradient (1, parameters).

        It is that of ces_observer.structures.network with the kinks rounded off, upward.
        """
        r = len(self.regressors)
        units = params[1 + r :].reshape(self.units, 2 + r)
        slope, parts = np.zeros_like(params), np.zeros_like(units)
        gain = 0.0
        for j in self.past:
            products = STEEPEST_SLOPE * units[:, 0] * units[:, 2 + j]
            rounded = np.hypot(products, KINK)
            high = params[1 + j] + 0.5 * (rounded + products).sum()
            low = params[1 + j] - 0.5 * (rounded - products).sum()
            sign = 1.0 if high >= -low else -1.0
            counts = 0.5 * STEEPEST_SLOPE * (sign + products / rounded)
            gain += max(high, -low)
            slope[1 + j] = sign
            parts[:, 0] += counts * units[:, 2 + j]
            parts[:, 2 + j] += counts * units[:, 0]
        slope[1 + r :] = parts.ravel()
        return np.array([gain]), slope[None]

    def model(self, params: F, sampling: Sampling) -> Model:
        """Return the model of these parameters."""
        r, t = len(self.regressors), self.training
        rows = params[1 + r :].reshape(self.units, 2 + r).tolist()
        units = tuple(SigmoidUnit(row[0], row[1], tuple(row[2:])) for row in rows)
        network = Network(self.regressors, t.scale_N, float(params[0]), tuple(params[1 : 1 + r].tolist()), units)
        return Model(sampling, network, t.envelope, t.force_envelope)
