"""The evidence stage: what is learnt of the simulation and of the noise before any effect is tried."""

from __future__ import annotations

from dataclasses import dataclass

from ces_gap.baseline.ceiling import Ceiling, learn_ceiling
from ces_gap.baseline.correction import LearnedCorrection, learn_correction
from ces_gap.baseline.noise import make_white_noise
from ces_gap.baseline.plant import Plant
from ces_gap.inference.evidence import Evidence, gather
from ces_gap.inference.static_map import static_features
from ces_gap.intake.prepare import DiagnosisInput


@dataclass(frozen=True)
class Baseline:
    """The plant without effects and the evidence against it.

    `plant` is the quick simulation with the `correction` that references taught (None without references). `ceiling` is
    what the generic learner makes of the gap.
    """

    plant: Plant
    correction: LearnedCorrection | None
    evidence: Evidence
    ceiling: Ceiling


def learn_baseline(inputs: DiagnosisInput) -> Baseline:
    """Return what the references teach; without any, a smooth map is projected out and the noise estimated."""
    if not inputs.reference:
        return _without_references(inputs)
    correction, learnt = learn_correction(inputs.reference)
    features = [correction.dictionary.features(t, t.inputs, t.simulated) for t in inputs.real]
    plant = Plant(inputs.cheap, correction)
    evidence = gather(inputs.real, plant, learnt.noise, features, learnt.covariance)
    return Baseline(plant, correction, evidence, learn_ceiling(evidence.traces, evidence.alone))


def _without_references(inputs: DiagnosisInput) -> Baseline:
    """Return the same with noise of no less than what the generic learner leaves."""
    ceiling = learn_ceiling(inputs.real, [t.simulated for t in inputs.real])
    noise = make_white_noise(max(ceiling.learnt.noise.rms_N, *(t.noise_N for t in inputs.real)))
    plant = Plant(inputs.cheap)
    return Baseline(plant, None, gather(inputs.real, plant, noise, static_features(inputs.real), None), ceiling)
