"""The cells of the tables: models evaluated on a second run of an experiment, and costs in words.

Forces outside a model's force envelope count as they are (the observer would withhold them). The inputs of our models
are clamped to their envelope, as on the vehicle; a model of the thesis' procedure has no such clamps.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache

from bench.thesis.models import OURS, PUBLISHED, REGRESSORS, THESIS, TrainingJob, TrainingOutcome, load_named_experiment
from bench.thesis.noise_floor import noise_floors
from bench.thesis.rows import POLYNOMIAL, TABLES, ThesisRow
from ces_identify.preparation.series import prepare
from ces_identify.recordings.recording import Recording
from ces_identify.validation.evaluate import VALIDATION, Evaluation, evaluate
from ces_observer.model import Envelope

FOLDER = "thesis"  # of the experiments
ANY = (-1e3, 1e3)  # [m, m/s, A] an envelope that never clamps
ANY_N = (-1e6, 1e6)  # [N] a force envelope that only an unstable run leaves

Outcomes = Mapping[TrainingJob, TrainingOutcome]
Evaluations = dict[tuple[str, str, ThesisRow], Evaluation | None]
"""By structure, procedure and row; None where there is no model."""


def make_job(structure: str, procedure: str, row: ThesisRow) -> TrainingJob:
    """Return the job whose model a row evaluates."""
    return TrainingJob(structure, procedure, (f"{FOLDER}/{row.source}",), row.size)


def cells() -> Iterator[tuple[str, str, ThesisRow]]:
    """Yield structure, procedure and row of every cell of the tables."""
    for structure, table in TABLES.items():
        for row in table.rows:
            yield structure, OURS, row
            yield structure, THESIS, row
            if structure == POLYNOMIAL and (REGRESSORS / f"{row.source}.yaml").exists():
                yield structure, PUBLISHED, row


def evaluate_all(outcomes: Outcomes, recordings: Mapping[str, Recording]) -> Evaluations:
    """Return the evaluation of every cell on the run of its row's target in `recordings`, which are by experiment."""
    return {
        cell: evaluate_outcome(outcomes[make_job(*cell)], recordings[cell[2].target], clamped=cell[1] == OURS)
        for cell in cells()
    }


def evaluate_outcome(outcome: TrainingOutcome, recording: Recording, clamped: bool = True) -> Evaluation | None:
    """Return the free run of an outcome's model, if it has one, on `recording`."""
    if outcome.model is None:
        return None
    envelope = outcome.model.envelope if clamped else Envelope(ANY, ANY, ANY)
    model = replace(outcome.model, envelope=envelope, force_envelope_N=ANY_N, certificate=None)
    return evaluate(model, [prepare(recording, model.sampling)], VALIDATION)[0]


@cache
def noise_floor(name: str) -> float:
    """Return J [%] of the noise-free force against the measured one, on the fresh run."""
    return noise_floors(load_named_experiment(name, fresh=True))[0]


def percent(evaluation: Evaluation | None) -> str:
    """Return the cost in percent, or why there is none."""
    if evaluation is None:
        return "none stable"
    return f"{evaluation.cost:.2f}" if math.isfinite(evaluation.cost) else "unstable"
