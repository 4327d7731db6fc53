"""The surrogate: exact where the force is known, close where inputs change, honest about its error, and replayed."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from engine_plant import SIMULATION, F, traced

from ces_gap.baseline.learner import Dictionary, Scales
from ces_gap.baseline.physical import SurrogateExample, make_recorded_examples
from ces_gap.baseline.plant import DirectSimulator, Plant
from ces_gap.baseline.surrogate import UNKNOWN_ERROR, Surrogate, carry_error, learn_surrogate
from ces_gap.effects.effect import Composition, Setting
from ces_gap.effects.library import library, library_effect
from ces_gap.trace import Trace, TraceInputs
from ces_observer.errors import ModelError

pytestmark = pytest.mark.slow
CALLED = DirectSimulator(SIMULATION)


@cache
def recordings() -> list[Trace]:
    return [traced(seed=s, seconds=8.0) for s in (1, 2, 3)]


@cache
def unseen() -> Trace:
    return traced(seed=9)


@cache
def constant_current() -> Trace:
    return traced(seed=4, constant_A=0.8)


@cache
def learnt() -> Surrogate:
    return learn_surrogate(make_recorded_examples(recordings()), recordings())


@cache
def learnt_from_little() -> Surrogate:
    short = [traced(seed=1, seconds=4.0)]
    return learn_surrogate(make_recorded_examples(short), short)


def rms(values: F, trace: Trace) -> float:
    return float(np.sqrt(np.mean(values[trace.usable] ** 2)))


def between_steps(trace: Trace) -> Trace:
    """The trace without 20 ms after each step of the current: this damper's valve has no lag, fitted ones have one."""
    stepped = np.diff(trace.inputs.current, prepend=trace.inputs.current[0]) != 0.0
    return replace(trace, usable=trace.usable & (np.convolve(stepped, np.ones(10))[: len(trace)] == 0.0))


def late(trace: Trace, delay_s: float) -> F:
    return np.interp(trace.time_s - delay_s, trace.time_s, trace.inputs.position)


def change(name: str, trace: Trace) -> TraceInputs:
    return {
        "weaker": trace.inputs.with_current(0.9 * trace.inputs.current),
        "late": trace.inputs.with_position(late(trace, 0.003), trace.rate_Hz),
    }[name]


def relative_error(surrogate: Surrogate, trace: Trace, inputs: TraceInputs) -> float:
    """The RMS error of the change of force, as a share of the change."""
    exact = CALLED.force(trace, inputs) - trace.simulated
    return rms(surrogate.force(trace, inputs) - trace.simulated - exact, trace) / rms(exact, trace)


def test_the_force_of_recorded_inputs_is_exact() -> None:
    np.testing.assert_allclose(learnt().force(unseen(), unseen().inputs), unseen().simulated, atol=1e-9)
    same = unseen().inputs.with_current(unseen().inputs.current + 0.0)
    np.testing.assert_allclose(learnt().force(unseen(), same), unseen().simulated, atol=1e-6)


@pytest.mark.parametrize("name", ["weaker", "late"])
def test_it_predicts_the_effect_of_changed_inputs_on_a_stroke_it_never_saw(name: str) -> None:
    assert relative_error(learnt(), unseen(), change(name, unseen())) < 0.12


def test_its_cost_is_that_on_data_left_out() -> None:
    error = (learnt().predict(unseen(), unseen().inputs) - unseen().simulated)[unseen().usable]
    true = unseen().simulated[unseen().usable]
    unseen_J = 100.0 * np.linalg.norm(error) / np.linalg.norm(true - true.mean())
    assert 0.1 < learnt().cost_J < 3.0
    assert 0.4 * learnt().cost_J < unseen_J < 2.5 * learnt().cost_J


@pytest.mark.parametrize("name", ["weaker", "late"])
def test_its_estimate_of_the_error_is_no_promise_that_it_breaks(name: str) -> None:
    few, trace = learnt_from_little(), between_steps(unseen())
    inputs = change(name, trace)
    size = rms(few.force(trace, inputs) - trace.simulated, trace)
    estimated = rms(few.error_of_change(trace, inputs), trace) / size
    assert relative_error(few, trace, inputs) < 2.0 * estimated
    assert estimated < 0.3
    assert 0.005 < few.difference_error < 0.3


def test_currents_far_from_recorded_ones_are_less_certain() -> None:
    constant = constant_current()
    surrogate = learn_surrogate(make_recorded_examples([constant]), [constant])
    shares = []
    for gain in (0.98, 0.7):
        inputs = constant.inputs.with_current(gain * constant.inputs.current)
        change = surrogate.force(constant, inputs) - constant.simulated
        shares.append(rms(surrogate.error_of_change(constant, inputs), constant) / rms(change, constant))
    assert shares[0] < shares[1]
    assert shares[1] >= 0.4


def test_without_two_models_the_error_is_a_share_of_the_change() -> None:
    one = replace(learnt(), models=(replace(learnt().models[0], share=1.0),), difference_error=0.3)
    inputs = change("weaker", unseen())
    expected = 0.3 * np.abs(one.force(unseen(), inputs) - unseen().simulated)
    np.testing.assert_allclose(one.error_of_change(unseen(), inputs), expected)


class Unasked(Surrogate):
    """A surrogate that must not be asked."""

    def predict(self, trace: Trace, inputs: TraceInputs) -> F:
        raise AssertionError("the surrogate was asked")


def unasked() -> Surrogate:
    return Unasked(learnt().models, None, np.empty(0), 1.0)


def test_only_effects_that_rerun_the_simulation_ask_it() -> None:
    for effect in (e for e in library() if not e.reruns):
        composition = Composition((Setting(effect, tuple(p.starts[0] for p in effect.parameters)),))
        recorded = Plant(unasked()).with_effects(composition, unseen())
        np.testing.assert_array_equal(recorded, Plant(CALLED).with_effects(composition, unseen()), effect.form)
        np.testing.assert_array_equal(Plant(unasked()).error_with_effects(composition, unseen()), 0.0, effect.form)
    delay = Setting(library_effect("position_delay", "shift"), (0.003,))
    with pytest.raises(AssertionError, match="was asked"):
        Plant(unasked()).with_effects(Composition((delay,)), unseen())


def test_effects_that_rerun_the_simulation_have_the_error_of_the_change() -> None:
    weaker = Composition((Setting(library_effect("current_scale", "gain"), (0.9,)),))
    inputs = weaker.drive(unseen(), unseen().simulated)
    found = Plant(learnt()).prepare_for(unseen()).error_with_effects(weaker, unseen())
    np.testing.assert_array_equal(found, learnt().error_of_change(unseen(), inputs))
    assert rms(found, unseen()) > 0.1
    np.testing.assert_array_equal(Plant(CALLED).error_with_effects(weaker, unseen()), 0.0)


def test_its_error_moves_in_time_with_the_motion() -> None:
    constant = constant_current()
    error = 50.0 * np.sin(2.0 * np.pi * 3.0 * constant.time_s)
    carried = carry_error(error, constant, constant.inputs.with_position(late(constant, 0.004), constant.rate_Hz))
    expected = 50.0 * np.sin(2.0 * np.pi * 3.0 * (constant.time_s - 0.004))
    np.testing.assert_allclose(carried[10:], expected[10:], atol=0.5)
    weaker = constant.inputs.with_current(0.5 * constant.inputs.current)
    np.testing.assert_array_equal(carry_error(error, constant, weaker), error)


def test_a_dictionary_replaces_physical_models_that_do_not_fit() -> None:
    """A force that falls with speed is no damper's."""
    recorded = make_recorded_examples(recordings()[:2])
    examples = [replace_force(e, -500.0 * np.tanh(e.inputs.speed / 0.05)) for e in recorded]
    surrogate = learn_surrogate(examples, [e.trace for e in examples])
    assert surrogate.dictionary is not None
    assert surrogate.cost_J < 15.0


def replace_force(example: SurrogateExample, force: F) -> SurrogateExample:
    return SurrogateExample(replace(example.trace, simulated=force), example.inputs, force)


def test_examples_without_motion_give_a_dictionary() -> None:
    still = traced(seed=1)
    inputs = TraceInputs(np.zeros(len(still)), np.zeros(len(still)), still.inputs.current)
    surrogate = learn_surrogate([SurrogateExample(still, inputs, still.simulated)], [still])
    assert surrogate.models == () and surrogate.dictionary is not None


def test_the_json_round_trip_is_exact() -> None:
    again = Surrogate.from_json(json.loads(json.dumps(learnt().as_json())))
    for trace in (unseen(), replace(unseen(), rate_Hz=400.0)):
        weaker = trace.inputs.with_current(0.9 * trace.inputs.current)
        np.testing.assert_array_equal(again.force(trace, weaker), learnt().force(trace, weaker))
    assert (again.cost_J, again.difference_error) == (learnt().cost_J, learnt().difference_error)


def test_surrogates_of_old_files_are_a_dictionary() -> None:
    dictionary = Dictionary(Scales((0.0, 0.01), 0.1, (0.6, 0.1), (0.0, 100.0), True), by_force=False)
    weights = np.linspace(-1.0, 1.0, dictionary.size)
    old = {"dictionary": asdict(dictionary), "weights": weights.tolist(), "cost_J": 9.0}
    surrogate = Surrogate.from_json(json.loads(json.dumps(old)))
    assert surrogate.difference_error == UNKNOWN_ERROR
    expected = dictionary.predict(unseen(), unseen().inputs, np.zeros(len(unseen())), weights)
    np.testing.assert_array_equal(surrogate.predict(unseen(), unseen().inputs), expected)


def test_other_documents_are_refused() -> None:
    sound = learnt().as_json()
    wrong: list[dict[str, Any]] = [
        {"schema": "ces-surrogate/3"},
        {"models": [{"share": 1.0, "structure": "spring", "rate_Hz": 500.0}]},
        {"models": [{**sound["models"][0], "share": 2.0}]},
        {"difference_error": -1.0},
    ]
    for document in ({"weights": []}, *({**sound, **change} for change in wrong)):
        with pytest.raises((ModelError, KeyError, TypeError, ValueError)):
            Surrogate.from_json(document)
