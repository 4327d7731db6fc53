"""The baseline stage: correction, noise and generic learner, before any effect is tried."""

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
    """The plant without effects, its evidence, and the generic learner fitted to the gap (`ceiling`).

    `plant` is the fast simulation with the `correction` learned from references (None without references).
    """

    plant: Plant
    correction: LearnedCorrection | None
    evidence: Evidence
    ceiling: Ceiling


def learn_baseline(inputs: DiagnosisInput) -> Baseline:
    """Return the baseline learned from references; without any, a static map is projected out and noise estimated."""
    if not inputs.reference:
        return _without_references(inputs)
    correction, learnt = learn_correction(inputs.reference)
    features = [correction.dictionary.features(t, t.inputs, t.simulated) for t in inputs.real]
    plant = Plant(inputs.cheap, correction)
    evidence = gather(inputs.real, plant, learnt.noise, features, learnt.covariance)
    return Baseline(plant, correction, evidence, learn_ceiling(evidence.traces, evidence.alone))


def _without_references(inputs: DiagnosisInput) -> Baseline:
    """Return the baseline with at least the noise that the generic learner leaves."""
    ceiling = learn_ceiling(inputs.real, [t.simulated for t in inputs.real])
    noise = make_white_noise(max(ceiling.learnt.noise.rms_N, *(t.noise_N for t in inputs.real)))
    plant = Plant(inputs.cheap)
    return Baseline(plant, None, gather(inputs.real, plant, noise, static_features(inputs.real), None), ceiling)
