"""The cells of the tables: models evaluated on a second run of an experiment, and the limits for any model.

    python -m bench.thesis.costs

prints for each packaged experiment J of the measured against the noise-free force, and J of the damper itself driven
with the recorded, noisy position and current (`load_rig`). Forces outside a model's force envelope count as they are
(the observer would withhold them). The inputs of our models are clamped to their envelope, as on the vehicle; a model
of the thesis' procedure has no such clamps.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from bench.thesis.models import (
    OURS,
    POLYNOMIAL,
    PUBLISHED,
    REGRESSORS,
    TABLES,
    THESIS,
    ThesisRow,
    TrainingJob,
    TrainingOutcome,
    load_named_experiment,
)
from ces_data.recording import Recording
from ces_identify.prepare.cost import cost
from ces_identify.prepare.series import prepare
from ces_identify.validation.evaluate import VALIDATION, Evaluation, evaluate
from ces_observer.model import Envelope
from ces_rig.experiments.virtual import (
    Experiment,
    describe_experiment,
    load_experiment,
    make_rig_force,
    measure,
    packaged_experiments,
    simulate_truth,
)

F = NDArray[np.float64]


def noise_floors(experiment: Experiment) -> tuple[float, float]:
    """Return J of the measured force against the noise-free one, and against the damper driven with the recording."""
    true = simulate_truth(experiment)
    recording = measure(experiment, true)
    force = recording.channel("force")
    _, noise_free = experiment.sensors.force.sample(true.time_s, true.force_N)
    return cost(force.values, noise_free), cost(force.values, simulate_driven(experiment, recording))


def simulate_driven(experiment: Experiment, recording: Recording) -> F:
    """Return the force [N] of the damper driven with the recorded position and current, at the force's stamps."""
    position, current, force = (recording.channel(name) for name in ("position", "current", "force"))
    time = (position.stamps_ns - position.stamps_ns[0]) * 1e-9
    function = make_rig_force(describe_experiment(experiment))
    simulated = function(time, position.values, np.interp(position.stamps_ns, current.stamps_ns, current.values))
    return np.asarray(np.interp(force.stamps_ns, position.stamps_ns, simulated))


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
    return "unstable" if evaluation.run.held.any() else f"{evaluation.cost:.2f}"


if __name__ == "__main__":
    print("| experiment | noise floor J | the damper itself on the recorded position J |\n|---|---:|---:|")
    for name, path in packaged_experiments().items():
        print("| {} | {:.2f} | {:.2f} |".format(name, *noise_floors(load_experiment(path))))
