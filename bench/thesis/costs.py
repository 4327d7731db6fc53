"""The cells of the tables: models evaluated on a second run of an experiment, and costs in words.

A model of the thesis' procedure runs without the clamps of this project's estimator: its inputs are not limited to the
envelope of its recording, and its force only to ten times that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

from bench.thesis.models import OURS, THESIS, TrainingJob, TrainingOutcome, load_named_experiment
from bench.thesis.noise_floor import noise_floors
from bench.thesis.rows import TABLES, ThesisRow
from ces_identify.preparation.series import prepare
from ces_identify.recordings.recording import Recording
from ces_identify.validation.evaluate import VALIDATION, Evaluation, evaluate
from ces_observer.model import Envelope, Model

FOLDER = "thesis"  # of the experiments
ANY = (-1e3, 1e3)  # [m, m/s, A] an envelope that never clamps
LOOSE = 10.0  # times the force envelope

Outcomes = Mapping[TrainingJob, TrainingOutcome]
Evaluations = dict[tuple[str, str, ThesisRow], Evaluation | None]
"""By structure, procedure and row; None where there is no model."""


def make_job(structure: str, procedure: str, row: ThesisRow) -> TrainingJob:
    """Return the job whose model a row evaluates."""
    return TrainingJob(structure, procedure, (f"{FOLDER}/{row.source}",), row.size)


def evaluate_all(outcomes: Outcomes, recordings: Mapping[str, Recording]) -> Evaluations:
    """Return the evaluation of every cell on the run of its row's target in `recordings`, which are by experiment."""
    return {
        (structure, procedure, row): evaluate_outcome(
            outcomes[make_job(structure, procedure, row)], recordings[row.target], clamped=procedure == OURS
        )
        for structure, table in TABLES.items()
        for procedure in (THESIS, OURS)
        for row in table.rows
    }


def evaluate_outcome(outcome: TrainingOutcome, recording: Recording, clamped: bool = True) -> Evaluation | None:
    """Return the free run of an outcome's model, if it has one, on `recording`."""
    if outcome.model is None:
        return None
    model = outcome.model if clamped else without_clamps(outcome.model)
    return evaluate(model, [prepare(recording, model.sampling)], VALIDATION)[0]


def without_clamps(model: Model) -> Model:
    """Return `model` with envelopes that no recording reaches and no certificate."""
    low, high = model.force_envelope_N
    wide = LOOSE * low, LOOSE * high
    return replace(model, envelope=Envelope(ANY, ANY, ANY), force_envelope_N=wide, certificate=None)


@cache
def noise_floor(name: str) -> float:
    """Return J [%] of the noise-free force against the measured one, on the fresh run."""
    return noise_floors(load_named_experiment(name, fresh=True))[0]


def percent(evaluation: Evaluation | None) -> str:
    """Return the cost in percent, or why there is none."""
    if evaluation is None:
        return "none stable"
    return f"{evaluation.cost:.2f}" if math.isfinite(evaluation.cost) else "unstable"
