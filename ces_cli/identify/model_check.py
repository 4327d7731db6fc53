"""The check of a recording against a model, for faults that the recording alone does not show."""

from __future__ import annotations

from dataclasses import replace

from ces_cli.terminal import terminal
from ces_identify.preparation.series import prepare
from ces_identify.recordings.checks import Finding
from ces_identify.recordings.recording import Recording
from ces_identify.sense.against_model import MIN_ERROR, signs_against_model, unit_against_model
from ces_identify.validation.evaluate import VALIDATION, Evaluation, evaluate
from ces_observer.model import Model

SIGNED = ("position", "force")


def print_against_model(
    model: Model, recording: Recording, evaluation: Evaluation, part: tuple[float, float]
) -> list[Finding]:
    """Print and return what a model shows to be wrong with a recording: the unit of the force, or both signs."""
    scored = evaluation.series.scored
    found = list(unit_against_model(evaluation.series.force[scored], evaluation.run.force[scored]))
    if not found and evaluation.cost > 100.0 * MIN_ERROR:
        series = prepare(reverse_signs(recording), model.sampling).part(*part)
        (turned,) = evaluate(model, [series], VALIDATION)
        found = list(signs_against_model(evaluation.cost, turned.cost))
    found = [replace(finding, text=f"{recording.name}: {finding.text}") for finding in found]
    for finding in found:
        terminal.print_warning(finding.text)
    return found


def reverse_signs(recording: Recording) -> Recording:
    """Return the recording with position and force of the opposite sign."""
    turned = {name: replace(recording.channels[name], values=-recording.channels[name].values) for name in SIGNED}
    return replace(recording, channels={**recording.channels, **turned})
