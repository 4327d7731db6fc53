"""A structure with physics inside as a family of models: its parameters, compiled free run and structure.

Fits, batch runs, standard errors and the report know such a structure only through its `PhysicalModels`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, Self, TypeVar

import numpy as np

from ces_data.arrays import F, I, Mask
from ces_identify.physical.layout import CURRENTS, POSITIONS, DataScales, Layout
from ces_identify.physical.valve_kernels import RunData, Score
from ces_identify.trained.training import Training
from ces_observer.model import Model
from ces_observer.structures.physical import INPUTS, PhysicalStructure, widen

FITTED_RATE_HZ = 500.0  # rate of the ticks whose errors a fit counts: forces hold nothing faster
NO_FIT = np.empty((0, 0))
SAME = 1e-6  # relative difference of the kernels' vector by rounding

Kernel = Callable[[Any, RunData, Score, F, F, F], tuple[float, int]]
Body = TypeVar("Body", bound=PhysicalStructure)


@dataclass(frozen=True)
class PhysicalModels(ABC, Generic[Body]):
    """All models of one structure and size on the same nodes, to be fitted to `training`."""

    training: Training
    scales: DataScales

    @classmethod
    @abstractmethod
    def sized(cls, training: Training, scales: DataScales, count: int) -> Self:
        """Return the models of a size that the user chooses."""

    @classmethod
    @abstractmethod
    def small(cls, training: Training, scales: DataScales, rows: int) -> Self:
        """Return models of the smallest size worth a fit, with `rows` curves of the valve."""

    @staticmethod
    @abstractmethod
    def kernel() -> Kernel:
        """Return the compiled free run."""

    @staticmethod
    @abstractmethod
    def arrays_of(body: Body, interval_s: float) -> Any:
        """Return the kernel's view of a structure; its first entry is the vector `k`."""

    @classmethod
    @abstractmethod
    def on_nodes_of(cls, body: Body, interval_s: float, training: Training) -> Self | None:
        """Return the models on the nodes of `body`; None if a fit gives other numbers of nodes."""

    @staticmethod
    @abstractmethod
    def own_quantities(body: Body, stroke_m: float) -> dict[str, float]:
        """Return the quantities that only this structure has, by names that hold their units."""

    @staticmethod
    def gas_stiffness_N_m(body: Body) -> float:
        """Return the stiffness [N/m] of what acts as a gas spring beside the gas force."""
        return 0.0

    @property
    @abstractmethod
    def layout(self) -> Layout:
        """The parameters."""

    @abstractmethod
    def arrays(self, k: F) -> Any:
        """Return the kernel's view of the model with the vector `k`."""

    @abstractmethod
    def body(self, theta: F) -> Body:
        """Return the structure with these parameters."""

    @classmethod
    def reopen(cls, body: Body, interval_s: float, training: Training) -> tuple[Self, F] | None:
        """Return the models on the nodes of `body` and its parameters theta; None if these models did not make it."""
        usual = (len(body.valve.characteristic.at), len(body.side.position_m)) == (CURRENTS, POSITIONS)
        models = cls.on_nodes_of(body, interval_s, training) if usual else None
        k = cls.arrays_of(body, interval_s).k
        if models is None or models.layout.matrix.shape[0] != len(k):
            return None
        layout = models.layout
        theta: F = np.asarray(np.linalg.lstsq(layout.matrix, k - layout.offset, rcond=None)[0], np.float64)
        inside = layout.project(theta)
        same = np.allclose(layout.k(inside), k, rtol=SAME, atol=SAME * np.abs(k).mean())
        return (models, inside) if same else None

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
        error, matrix, gradients = self.sensitivities(theta, weights, np.zeros(len(weights), np.int64))
        return error, matrix, gradients[0]

    def sensitivities(self, theta: F, weights: F, blocks: I) -> tuple[float, F, F]:
        """Return error, Gauss-Newton matrix, and the gradients (blocks, parameters) of each block of ticks."""
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
        error, _ = self.kernel()(self.arrays(self.layout.k(theta)), self.data, score, force, matrix, gradients)
        return force, float(error)


def free_run(kernel: Kernel, arrays: Any, data: RunData) -> F:
    """Return the force (ticks,) [N] of the model that `arrays` holds for `kernel`."""
    ticks = len(data.position)
    force = np.full(ticks, np.nan)
    nothing = Score(np.zeros(ticks), np.zeros(ticks), np.zeros(ticks, np.int64), 1)
    kernel(arrays, data, nothing, force, NO_FIT, NO_FIT)
    return force


def run_model(models: type[PhysicalModels[Body]], body: Body, model: Model, inputs: F, segments: I) -> tuple[F, Mask]:
    """Return the batch run of a physical model, as `StructureKit.batch_run` describes it."""
    ranges = widen(model.envelope.by_signal, body.reach)
    limited = [np.ascontiguousarray(np.clip(row, *ranges[name])) for row, name in zip(inputs, INPUTS, strict=True)]
    data = RunData(limited[0], limited[1], limited[2], np.asarray(segments, np.int64))
    force = free_run(models.kernel(), models.arrays_of(body, 1.0 / model.sampling.rate_Hz), data)
    for start, stop in segments:
        force[start:stop][np.logical_or.accumulate(~np.isfinite(force[start:stop]))] = np.nan
    low, high = model.force_envelope_N
    return np.clip(force, low, high), (force < low) | (force > high)
