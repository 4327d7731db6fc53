"""Sigmoid networks in a simulation-error fit: random starts, errors with their derivatives, and the gain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ces_identify.numerics.arrays import F
from ces_identify.trained.family import Family
from ces_identify.trained.lagged_kernels import RegressorTable
from ces_identify.trained.network_kernels import NetworkArrays
from ces_observer.structures.network import Network, SigmoidUnit

FIRST_GAIN = 0.9  # gain of the past forces in a start
FIRST_SLOPE = 1.5  # standard deviation of a start's slopes, all inputs together
FIRST_WEIGHT = 0.05
STEEPEST_SLOPE = 0.25  # of a sigmoid
KINK = 5e-4  # width over which the kink of |x| is smoothed in the gain


@dataclass(frozen=True)
class NetworkFit(Family):
    """Networks of `units` sigmoids; `decay` is the cost of a squared parameter in (J / 100)^2."""

    units: int
    decay: float

    @property
    def size(self) -> int:
        """Number of units."""
        return self.units

    def start(self, random: np.random.Generator) -> F:
        """Return random parameters: a slow affine model of the past, and units that depend on the inputs only."""
        r = len(self.regressors)
        linear, units = np.zeros(r), random.normal(0.0, FIRST_SLOPE / np.sqrt(r), (self.units, 2 + r))
        linear[self.past] = FIRST_GAIN / max(1, len(self.past))
        units[:, 0] = random.normal(0.0, FIRST_WEIGHT, self.units)
        units[:, 1] = random.normal(0.0, 1.0, self.units)
        units[:, 2 + self.past] = 0.0
        constant = (1.0 - linear.sum()) * self.training.level
        return np.concatenate([[constant], linear, units.ravel()])

    def errors_on(self, table: RegressorTable, params: F, max_error: float) -> tuple[float, F, F]:
        """Return the squared error with decay, its matrix and its gradient."""
        error, matrix, gradient = self.normal_equations(table, params, max_error)
        matrix[np.diag_indices_from(matrix)] += self.decay
        return error + self.decay * float(params @ params), matrix, gradient - self.decay * params

    def kernel_arrays(self, params: F) -> NetworkArrays:
        """Return the arrays of the kernels."""
        return NetworkArrays(self.training.scale_N, params, self.units)

    def gains(self, params: F) -> tuple[F, F]:
        """Return the bound of ces_observer.structures.network (1,), smoothed upward, and its gradient (1, params)."""
        r = len(self.regressors)
        units = params[1 + r :].reshape(self.units, 2 + r)
        slope, unit_slopes = np.zeros_like(params), np.zeros_like(units)
        gain = 0.0
        for j in self.past:
            products = STEEPEST_SLOPE * units[:, 0] * units[:, 2 + j]
            smoothed = np.hypot(products, KINK)
            high = params[1 + j] + 0.5 * (smoothed + products).sum()
            low = params[1 + j] - 0.5 * (smoothed - products).sum()
            sign = 1.0 if high >= -low else -1.0
            derivative = 0.5 * STEEPEST_SLOPE * (sign + products / smoothed)
            gain += max(high, -low)
            slope[1 + j] = sign
            unit_slopes[:, 0] += derivative * units[:, 2 + j]
            unit_slopes[:, 2 + j] += derivative * units[:, 0]
        slope[1 + r :] = unit_slopes.ravel()
        return np.array([gain]), slope[None]

    def body(self, params: F) -> Network:
        """Return the network with these parameters."""
        r = len(self.regressors)
        rows = params[1 + r :].reshape(self.units, 2 + r).tolist()
        units = tuple(SigmoidUnit(row[0], row[1], tuple(row[2:])) for row in rows)
        linear = tuple(params[1 : 1 + r].tolist())
        return Network(self.regressors, self.training.scale_N, float(params[0]), linear, units)
