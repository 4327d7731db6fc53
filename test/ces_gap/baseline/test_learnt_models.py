"""Models of the generic learner: the correction and the ceiling."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from engine_plant import NOISE_N, F, damper, traced

from ces_gap.baseline.learner import LearnedCorrection, learn_ceiling, learn_correction
from ces_gap.trace import Trace


def wrong(time_s: F, position_m: F, current_A: F) -> F:
    """A real damper of which the simulation is a rough model."""
    speed = np.gradient(position_m, time_s)
    return np.asarray(1.06 * damper(time_s, position_m, current_A) + 70.0 * np.tanh(speed / 0.1) + 40.0 * speed)


def truth(trace: Trace) -> F:
    return wrong(trace.time_s, trace.inputs.position, trace.inputs.current)


def rms(values: F, trace: Trace) -> float:
    return float(np.sqrt(np.mean(values[trace.usable] ** 2)))


REFERENCES = [traced(wrong, seed=s, seconds=10.0) for s in (1, 2, 3)]
UNSEEN = traced(wrong, seed=9)
CORRECTION, LEARNT = learn_correction(REFERENCES)


def test_references_teach_the_baseline_error() -> None:
    own = truth(UNSEEN) - UNSEEN.simulated
    predicted = CORRECTION.force(UNSEEN, UNSEEN.inputs, UNSEEN.simulated)
    assert rms(own, UNSEEN) > 5.0 * NOISE_N
    assert rms(own - predicted, UNSEEN) < 0.5 * NOISE_N


def test_the_noise_of_the_fit_is_the_measurement_noise() -> None:
    assert LEARNT.noise.rms_N == pytest.approx(NOISE_N, rel=0.1)
    for trace, predicted in zip(REFERENCES, LEARNT.crossfitted, strict=True):
        assert rms(trace.force - trace.simulated - predicted, trace) == pytest.approx(NOISE_N, rel=0.1)


def test_the_correction_of_a_correct_simulation_is_nearly_zero() -> None:
    right = [traced(seed=s) for s in (1, 2)]
    correction, _ = learn_correction(right)
    unseen = traced(seed=9)
    assert rms(correction.force(unseen, unseen.inputs, unseen.simulated), unseen) < 0.3 * NOISE_N


def test_the_json_round_trip_of_a_correction_is_exact() -> None:
    again = LearnedCorrection.from_json(json.loads(json.dumps(CORRECTION.as_json())))
    assert again.dictionary == CORRECTION.dictionary
    np.testing.assert_array_equal(
        again.force(UNSEEN, UNSEEN.inputs, UNSEEN.simulated), CORRECTION.force(UNSEEN, UNSEEN.inputs, UNSEEN.simulated)
    )
    with pytest.raises(KeyError):
        LearnedCorrection.from_json({"weights": [1.0]})


def test_the_ceiling_explains_a_drift_with_time() -> None:
    rng = np.random.default_rng(1)
    fading = [
        replace(t, force=t.simulated * (1.0 - 0.01 * t.time_s) + NOISE_N * rng.standard_normal(len(t)))
        for t in REFERENCES
    ]
    learnt = learn_ceiling(fading, [t.simulated for t in fading]).learnt
    for trace, predicted in zip(fading, learnt.crossfitted, strict=True):
        gap = -0.01 * trace.time_s * trace.simulated
        assert rms(gap - predicted, trace) < 0.3 * rms(gap, trace)


def test_the_ceiling_explains_hardly_any_noise() -> None:
    right = [traced(seed=s, seconds=10.0) for s in (1, 2)]
    learnt = learn_ceiling(right, [t.simulated for t in right]).learnt
    for trace, predicted in zip(right, learnt.crossfitted, strict=True):
        assert rms(predicted, trace) < 0.25 * NOISE_N
