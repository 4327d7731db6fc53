"""A physical structure as a family of models: parameters within bounds, compiled free run, and the structure itself."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ces_identify.numerics.arrays import F, I
from ces_identify.physical.common_groups import DataScales
from ces_identify.physical.layout import Layout
from ces_identify.physical.valve_kernels import RunData, Score
from ces_identify.trained.training import Training
from ces_observer.structures.chambers import Chambers
from ces_observer.structures.relaxation import Relaxation

FITTED_RATE_HZ = 500.0  # rate of the ticks whose errors a fit counts: forces hold nothing faster
NO_FIT = np.empty((0, 0))

Body = Relaxation | Chambers
Kernel = Callable[[Any, RunData, Score, F, F, F], tuple[float, int]]


@dataclass(frozen=True)
class PhysicalModels(ABC):
    """All models of one structure and size on the same nodes, to be fitted to `training`."""

    training: Training
    scales: DataScales

    @property
    @abstractmethod
    def layout(self) -> Layout:
        """The parameters."""

    @property
    @abstractmethod
    def kernel(self) -> Kernel:
        """The compiled free run."""

    @abstractmethod
    def arrays(self, k: F) -> Any:
        """Return the kernel's view of the model with the vector `k`."""

    @abstractmethod
    def body(self, theta: F) -> Body:
        """Return the structure with these parameters."""

    @cached_property
    def data(self) -> RunData:
        """The inputs of the training data."""
        position, speed, current = (np.ascontiguousarray(row) for row in self.training.inputs)
        return RunData(position, speed, current, self.training.segments)

    @cached_property
    def stride(self) -> int:
        """Only every `stride`-th tick counts in a fit."""
        return max(1, round(1.0 / (self.scales.interval_s * FITTED_RATE_HZ)))

    def force(self, theta: F) -> F:
        """Return the free run (ticks,) [N]."""
        return self._run(theta, self._score(np.zeros(len(self.training.measured)), 1), NO_FIT, NO_FIT)[0]

    def cost(self, theta: F, weights: F) -> float:
        """Return the mean J [%] over the recordings for weights (ticks,) as in `Training`."""
        return self.training.cost(self.force(theta), weights)

    def error(self, theta: F, weights: F) -> float:
        """Return the squared error for weights (ticks,) as in `Training`."""
        return self._run(theta, self._score(weights, self.stride), NO_FIT, NO_FIT)[1] * self.stride

    def normal_equations(self, theta: F, weights: F) -> tuple[float, F, F]:
        """Return the squared error, its Gauss-Newton matrix and the gradient of half of it, by the parameters."""
        error, matrix, gradients = self._sensitivities(theta, weights, np.zeros(len(weights), np.int64))
        return error, matrix, gradients[0]

    def block_gradients(self, theta: F, weights: F, blocks: I) -> tuple[F, F]:
        """Return the Gauss-Newton matrix, and the gradients (blocks, parameters) of each block of ticks."""
        _, matrix, gradients = self._sensitivities(theta, weights, blocks)
        return matrix, gradients

    def _sensitivities(self, theta: F, weights: F, blocks: I) -> tuple[float, F, F]:
        size = len(self.layout.offset)
        matrix, gradients = np.zeros((size, size)), np.zeros((int(blocks.max()) + 1, size))
        score = Score(self.training.measured, np.sqrt(weights), blocks, self.stride)
        _, error = self._run(theta, score, matrix, gradients)
        matrix += np.triu(matrix, 1).T
        to = self.layout.matrix
        return error * self.stride, self.stride * (to.T @ matrix @ to), self.stride * (gradients @ to)

    def _score(self, weights: F, stride: int) -> Score:
        return Score(self.training.measured, np.sqrt(weights), np.zeros(len(weights), np.int64), stride)

    def _run(self, theta: F, score: Score, matrix: F, gradients: F) -> tuple[F, float]:
        force = np.empty(len(self.training.measured))
        error, _ = self.kernel(self.arrays(self.layout.k(theta)), self.data, score, force, matrix, gradients)
        return force, float(error)
