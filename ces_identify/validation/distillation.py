"""What is lost when a model learns a teacher's force instead of the measured one.

A model and the recordings with the teacher's force go in, with the same recordings as measured; three costs J side by
side come out: of the model against its teacher, of the teacher against the measured force, of the model against that.
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
    """Costs J [%] on one recording, in the role it had; NaN against a force that was not measured."""

    recording: str
    role: str
    model_to_teacher: float
    teacher_to_measured: float
    model_to_measured: float

    @property
    def loss(self) -> float:
        """By how much [%] the model is further from the measured force than its teacher is."""
        return self.model_to_measured - self.teacher_to_measured


def compare_with_teacher(
    model: Model, evaluations: Sequence[Evaluation], measured: Sequence[Recording]
) -> tuple[DistillationCosts, ...]:
    """Return the costs on each evaluation of `model`, whose series hold the teacher's force.

    `measured` are the same recordings as they were logged, in any order; those without a force are left out.
    """
    known = [prepare(recording, model.sampling) for recording in measured if "force" in recording.channels]
    return tuple(_costs(evaluation, _find_measured_force(evaluation.series, known)) for evaluation in evaluations)


def _costs(evaluation: Evaluation, measured: F) -> DistillationCosts:
    series, told = evaluation.series, (evaluation.name, evaluation.role, evaluation.cost)
    both = series.scored & np.isfinite(measured)
    if both.sum() < MIN_TICKS or np.ptp(measured[both]) == 0.0:
        return DistillationCosts(*told, np.nan, np.nan)
    truth = measured[both]
    return DistillationCosts(*told, cost(truth, series.force[both]), cost(truth, evaluation.run.force[both]))


def _find_measured_force(series: Series, known: Sequence[Series]) -> F:
    """Return the measured force [N] on the ticks of `series`, a part of one of the known: the one of equal ticks."""
    for whole in known:
        first = int(np.searchsorted(whole.time_s, series.time_s[0]))
        part = slice(first, first + len(series))
        if whole.name == series.name and np.array_equal(whole.position[part], series.position):
            return whole.force[part]
    return np.full(len(series), np.nan)
