"""The loss when a model learns from a teacher's force instead of the measured one.

A model, evaluations with the teacher's force and the recordings as measured go in. Three costs J come out: model
against teacher, teacher against measurement, and model against measurement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ces_identify.numerics.arrays import F
from ces_identify.preparation.cost import cost
from ces_identify.preparation.series import Series, prepare
from ces_identify.recordings.recording import Recording
from ces_identify.validation.evaluate import Evaluation
from ces_observer.model import Model

MIN_TICKS = 50  # with a measured force


@dataclass(frozen=True)
class DistillationCosts:
    """Costs J [%] on one recording; NaN without a measured force."""

    recording: str
    role: str
    model_to_teacher: float
    teacher_to_measured: float
    model_to_measured: float

    @property
    def loss(self) -> float:
        """By how much [%] the model's cost against the measured force exceeds its teacher's."""
        return self.model_to_measured - self.teacher_to_measured


def compare_with_teacher(
    model: Model, evaluations: Sequence[Evaluation], measured: Sequence[Recording]
) -> tuple[DistillationCosts, ...]:
    """Return the costs on evaluations with the teacher's force; `measured` are the original recordings."""
    prepared = [prepare(recording, model.sampling) for recording in measured if "force" in recording.channels]
    return tuple(_costs(evaluation, _find_measured_force(evaluation.series, prepared)) for evaluation in evaluations)


def _costs(evaluation: Evaluation, measured: F) -> DistillationCosts:
    series, head = evaluation.series, (evaluation.name, evaluation.role, evaluation.cost)
    both = series.scored & np.isfinite(measured)
    if both.sum() < MIN_TICKS or np.ptp(measured[both]) == 0.0:
        return DistillationCosts(*head, np.nan, np.nan)
    truth = measured[both]
    return DistillationCosts(*head, cost(truth, series.force[both]), cost(truth, evaluation.run.force[both]))


def _find_measured_force(series: Series, measured: Sequence[Series]) -> F:
    """Return the measured force [N] on the ticks of `series` from the series that it is a part of, else NaN."""
    for whole in measured:
        first = int(np.searchsorted(whole.time_s, series.time_s[0]))
        part = slice(first, first + len(series))
        if whole.name == series.name and np.array_equal(whole.position[part], series.position):
            return whole.force[part]
    return np.full(len(series), np.nan)
