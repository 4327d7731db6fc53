"""The loss when a model learns from a teacher's force instead of the measured one.

A model, evaluations with the teacher's force and the recordings as measured go in. Three costs J come out: model
against teacher, teacher against measurement, and model against measurement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ces_data.arrays import F, Mask
from ces_data.recording import Recording
from ces_identify.polynomial.problem import BLOCK_S, ESTIMATION_BLOCKS, PERIOD_BLOCKS, estimation_ticks
from ces_identify.prepare.cost import cost
from ces_identify.prepare.series import Series, prepare
from ces_identify.validation.evaluate import Evaluation
from ces_observer.model import Model

MIN_TICKS = 50  # with a measured force
RULE = (
    f"of every {PERIOD_BLOCKS * BLOCK_S:g} s of identification data, the first {ESTIMATION_BLOCKS * BLOCK_S:g} s serve "
    f"estimation and the last {(PERIOD_BLOCKS - ESTIMATION_BLOCKS) * BLOCK_S:g} s selection; a last fit may use both; "
    "no choice used the test seconds"
)


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


def usage(identified: Sequence[Series], held_out: Sequence[Series]) -> list[dict[str, Any]]:
    """Return a row for each series: its start and end [s], and its scored seconds of each kind."""
    rows = [_row(series, estimation_ticks(series)) for series in identified]
    return rows + [_row(series, None) for series in held_out]


def _row(series: Series, estimation: Mask | None) -> dict[str, Any]:
    scored, none = series.scored, np.zeros(len(series), bool)
    masks = (none, none, scored) if estimation is None else (scored & estimation, scored & ~estimation, none)
    seconds = [round(float(mask.sum()) * (1.0 / series.rate_Hz), 1) for mask in masks]
    return {
        "recording": series.name,
        "from_s": round(float(series.time_s[0]), 2),
        "to_s": round(float(series.time_s[-1]), 2),
        **dict(zip(("estimation_s", "selection_s", "test_s"), seconds, strict=True)),
    }
