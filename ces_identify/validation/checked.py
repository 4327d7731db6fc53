"""A model on a recording: its evaluation, and what the model shows to be wrong with the recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ces_data.arrays import F
from ces_data.checks.content import find_known_recording
from ces_data.checks.units import signs_against_model, unit_against_model
from ces_data.findings import WARNING, WRONG_MODEL, Finding
from ces_data.limits import StatisticLimits
from ces_data.recording import Recording
from ces_identify.prepare.series import prepare
from ces_identify.simulations.simulate import SampleRun, sample_run
from ces_identify.simulations.simulation import ModelSimulation, Simulation
from ces_identify.validation.evaluate import (
    IDENTIFICATION,
    VALIDATION,
    Evaluation,
    describe_held,
    describe_lost,
    describe_outside,
    evaluate,
    outside_ranges,
)
from ces_observer.model import Model

SIGNED = ("position", "force")


def evaluate_checked(
    model: Model, recording: Recording, findings: Sequence[Finding]
) -> tuple[Evaluation, tuple[Finding, ...]]:
    """Return the evaluation of `model` on a recording, and what comes to the `findings` of the checks.

    The model was identified on it, its unit of the force differs, or both signs do. Raises CesError without a force.
    """
    name, known_as = recording.name, find_known_recording(recording, model.provenance)
    (evaluation,) = evaluate(model, [prepare(recording, model.sampling)], IDENTIFICATION if known_as else VALIDATION)
    if known_as:
        text = f"the model was identified on seconds of this recording (as '{known_as}'): its cost here is lower than"
        return evaluation, (Finding(WARNING, f"{name}: {text} on new data", recording=name),)
    if any(f.severity == WRONG_MODEL and f.recording == name for f in findings):
        return evaluation, ()
    return evaluation, tuple(
        replace(f, text=f"{name}: {f.text}", recording=name) for f in _find_against_model(model, recording, evaluation)
    )


def _find_against_model(model: Model, recording: Recording, evaluation: Evaluation) -> Sequence[Finding]:
    """Return what a model shows to be wrong with a recording: the unit of the force, or both signs."""
    scored = evaluation.series.scored
    findings = list(unit_against_model(evaluation.series.force[scored], evaluation.run.force[scored]))
    if findings or evaluation.cost <= 100.0 * StatisticLimits.EXPLAINED:
        return findings
    low, high = model.sampling.stroke_m
    sampling = replace(model.sampling, stroke_m=(min(low, -high), max(high, -low)))
    (turned,) = evaluate(model, [prepare(reverse_signs(recording), sampling)], VALIDATION)
    return list(signs_against_model(evaluation.cost, turned.cost))


def reverse_signs(recording: Recording) -> Recording:
    """Return the recording with position and force of the opposite sign."""
    turned = {name: replace(recording.channels[name], values=-recording.channels[name].values) for name in SIGNED}
    return replace(recording, channels={**recording.channels, **turned})


def simulate_checked(simulation: Simulation, recording: Recording) -> tuple[F, SampleRun | None, list[str]]:
    """Return the force [N] at every position sample (n,), the run of the model inside, if any, and its warnings."""
    inside = simulation.innermost
    run = sample_run(inside.model, recording) if isinstance(inside, ModelSimulation) else None
    force = simulation.force(recording) if run is None or inside is not simulation else run.force
    return force, run, [] if run is None else list(warnings_on(run, recording.name))


def warnings_on(run: SampleRun, name: str) -> Iterator[str]:
    """Yield for how long a run on the recording `name` has no force, or is outside the model's envelopes."""
    if lost := describe_lost(name, float(np.mean(~np.isfinite(run.force))), run.series):
        yield lost
    if uses := outside_ranges(run.model, run.series):
        yield describe_outside(name, float(np.mean(run.run.clamped)), uses)
    if held := describe_held(name, *run.held_at(np.isfinite(run.force))):
        yield held
