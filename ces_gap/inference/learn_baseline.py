"""The baseline stage: correction, noise and generic learner, before any effect is tried."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ces_gap.baseline.ceiling import Ceiling, learn_ceiling
from ces_gap.baseline.correction import LearnedCorrection, learn_correction
from ces_gap.baseline.noise import NoiseModel, make_white_noise
from ces_gap.baseline.plant import Plant
from ces_gap.inference.evidence import Evidence, gather
from ces_gap.intake.prepare import DiagnosisInput
from ces_gap.trace import Trace

NUMERICAL_ERROR = 1e-3  # of the RMS force: simulations are not computed more accurately
MIN_NOISE_N = 1e-3  # [N]


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
    """Return the baseline learned from references; without any, the simulation is taken as it is."""
    if not inputs.reference:
        return _without_references(inputs)
    correction, learnt = learn_correction(inputs.reference)
    features = [correction.dictionary.features(t, t.inputs, t.simulated) for t in inputs.real]
    plant = Plant(inputs.cheap, correction)
    evidence = gather(inputs.real, plant, learnt.noise, features, learnt.covariance)
    return Baseline(plant, correction, evidence, learn_ceiling(evidence.traces, evidence.alone))


def _without_references(inputs: DiagnosisInput) -> Baseline:
    """Return the baseline with the noise that was measured; what else the force contains is to be explained."""
    ceiling = learn_ceiling(inputs.real, [t.simulated for t in inputs.real])
    plant = Plant(inputs.cheap)
    return Baseline(plant, None, gather(inputs.real, plant, _measured_noise(inputs.real)), ceiling)


def _measured_noise(traces: Sequence[Trace]) -> NoiseModel:
    """Return white noise as strong as measured, but not below the numerical error of simulations."""
    force = np.concatenate([t.force[t.usable] for t in traces])
    noise_N = float(np.sqrt(np.mean([t.noise_N**2 for t in traces])))
    return make_white_noise(max(noise_N, NUMERICAL_ERROR * float(np.sqrt(np.mean(force**2))), MIN_NOISE_N))
