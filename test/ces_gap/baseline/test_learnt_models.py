"""Models of the generic learner: the correction, the surrogate and the ceiling."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from engine_plant import NOISE_N, SIMULATION, F, damper, traced

from ces_gap.baseline.ceiling import learn_ceiling
from ces_gap.baseline.correction import LearnedCorrection, learn_correction
from ces_gap.baseline.plant import DirectSimulator
from ces_gap.baseline.surrogate import Surrogate, learn_surrogate, make_changed_examples, make_recorded_examples
from ces_gap.trace import Trace

CALLED = DirectSimulator(SIMULATION)


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
SURROGATE = learn_surrogate(make_changed_examples(REFERENCES[:2], CALLED))


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


def test_the_surrogate_keeps_the_force_of_recorded_inputs() -> None:
    np.testing.assert_allclose(SURROGATE.force(UNSEEN, UNSEEN.inputs), UNSEEN.simulated, atol=1e-9)
    same = UNSEEN.inputs.with_current(UNSEEN.inputs.current + 0.0)
    np.testing.assert_allclose(SURROGATE.force(UNSEEN, same), UNSEEN.simulated, atol=1e-6)


@pytest.mark.parametrize("change", ["weaker", "late"])
def test_the_surrogate_predicts_the_effect_of_changed_inputs(change: str) -> None:
    trace = REFERENCES[2]  # of which it never saw a change
    late = np.interp(trace.time_s - 0.003, trace.time_s, trace.inputs.position)
    inputs = {
        "weaker": trace.inputs.with_current(0.93 * trace.inputs.current),
        "late": trace.inputs.with_position(late, trace.rate_Hz),
    }[change]
    exact = CALLED.force(trace, inputs) - trace.simulated
    predicted = SURROGATE.force(trace, inputs) - trace.simulated
    assert rms(predicted - exact, trace) < 0.45 * rms(exact, trace)


def test_the_surrogate_of_a_constant_current_learns_the_current_from_changed_inputs() -> None:
    constant = [traced(seed=s, constant_A=0.8) for s in (1, 2)]
    surrogate, trace = learn_surrogate(make_changed_examples(constant, CALLED)), constant[0]
    stronger = trace.inputs.with_current(1.05 * trace.inputs.current)
    added = CALLED.force(trace, stronger) - trace.simulated
    assert rms(surrogate.force(trace, stronger) - trace.simulated - added, trace) < 0.5 * rms(added, trace)


def test_the_cost_of_the_surrogate_is_that_on_held_out_data() -> None:
    surrogate, use = learn_surrogate(make_recorded_examples(REFERENCES)), UNSEEN.usable
    predicted = surrogate.dictionary.predict(UNSEEN, UNSEEN.inputs, np.zeros(len(UNSEEN)), surrogate.weights)
    spread = np.linalg.norm(UNSEEN.simulated[use] - UNSEEN.simulated[use].mean())
    unseen_J = 100.0 * np.linalg.norm((predicted - UNSEEN.simulated)[use]) / spread
    assert surrogate.cost_J > 1.0
    assert (
        0.5 * surrogate.cost_J < unseen_J < 2.5 * surrogate.cost_J
    )  # another stroke is a little harder than another block


def test_the_json_round_trip_of_a_surrogate_is_exact() -> None:
    again = Surrogate.from_json(json.loads(json.dumps(SURROGATE.as_json())))
    weaker = UNSEEN.inputs.with_current(0.9 * UNSEEN.inputs.current)
    np.testing.assert_array_equal(again.force(UNSEEN, weaker), SURROGATE.force(UNSEEN, weaker))
    np.testing.assert_array_equal(SURROGATE.prepare_for(UNSEEN).force(UNSEEN, weaker), SURROGATE.force(UNSEEN, weaker))
    assert again.cost_J == SURROGATE.cost_J
    with pytest.raises((KeyError, TypeError, ValueError)):
        Surrogate.from_json({"weights": []})


def test_examples_are_the_recorded_inputs_and_two_changes_of_each() -> None:
    examples = make_changed_examples(REFERENCES[:2], CALLED)
    assert len(examples) == 6 and [e.inputs for e in examples[:2]] == [t.inputs for t in REFERENCES[:2]]
    for example in examples:
        assert np.isfinite(example.force).all() and len(example.force) == len(example.trace)
    for example in examples[2:]:
        np.testing.assert_allclose(example.force, CALLED.force(example.trace, example.inputs))
        assert rms(example.force - example.trace.simulated, example.trace) > 5.0
    assert all(e.force is t.simulated for e, t in zip(make_recorded_examples(REFERENCES), REFERENCES, strict=True))


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
