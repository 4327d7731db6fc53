"""The plant: the simulation with other inputs, its correction, and effects around it in their order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from engine_plant import SIMULATION, F, damper, recorded, traced
from example_effects import CurrentGain, Scale, Spring
from search_examples import Offset

from ces_data.recording import Channel
from ces_gap.baseline.plant import DirectSimulator, Plant, TraceSimulator, change_recording
from ces_gap.effects.effect import CELL, Composition, Effect, EffectParameter, Setting
from ces_gap.trace import Trace, TraceInputs, open_trace

CALLED = DirectSimulator(SIMULATION)


@pytest.fixture(scope="module")
def trace() -> Trace:
    return traced()


class Late(Effect):
    """The position delayed in proportion to the force."""

    name, form, stage, reruns = "late", "shift", 0, True
    parameters = (EffectParameter("delay_s", 0.0, 0.1, (0.01,), "delay", magnitude=True),)

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        return inputs.with_position(np.interp(trace.time_s - values[0], trace.time_s, inputs.position), trace.rate_Hz)


class Added(Offset):
    """A constant added to the force at the cell."""

    name, stage = "added", CELL


class Tenth:
    """A correction of a tenth of the force."""

    def force(self, trace: Trace, inputs: TraceInputs, simulated: F) -> F:
        return np.asarray(0.1 * simulated)


class NeverCalled(TraceSimulator):
    """A simulation that may not be run again."""

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        raise AssertionError


def test_recorded_inputs_do_not_run_the_simulation(trace: Trace) -> None:
    assert Plant(NeverCalled()).alone(trace) is trace.simulated
    np.testing.assert_array_equal(CALLED.force(trace, trace.inputs), trace.simulated)
    equal = replace(trace.inputs, position=trace.inputs.position.copy())  # what counts is the numbers
    np.testing.assert_array_equal(CALLED.force(trace, equal), trace.simulated)


def test_another_current_and_another_position_are_simulated(trace: Trace) -> None:
    force = CALLED.force(trace, trace.inputs.with_current(trace.inputs.current + 0.3))
    expected = damper(trace.time_s, trace.inputs.position, trace.inputs.current + 0.3)
    np.testing.assert_allclose(force[trace.usable], expected[trace.usable], atol=20.0)
    assert np.abs(expected - trace.simulated).max() > 100.0
    moved = trace.inputs.with_position(0.5 * trace.inputs.position, trace.rate_Hz)
    expected = damper(trace.time_s, 0.5 * trace.inputs.position, trace.inputs.current)
    np.testing.assert_allclose(CALLED.force(trace, moved)[trace.usable], expected[trace.usable], atol=20.0)


def test_a_constant_current_can_be_changed_too() -> None:
    recording = recorded(constant_A=0.6)
    channels = {n: c for n, c in recording.channels.items() if n != "current"}
    trace = open_trace(SIMULATION, replace(recording, channels=channels, constants={"current": 0.6}))
    rising = 0.6 + 0.05 * trace.time_s
    changed = change_recording(trace, trace.inputs.with_current(rising))
    assert "current" not in changed.constants and "current" in changed.channels
    expected = damper(trace.time_s, trace.inputs.position, rising)
    np.testing.assert_allclose(
        CALLED.force(trace, trace.inputs.with_current(rising))[trace.usable], expected[trace.usable], atol=20.0
    )


def test_a_rerun_keeps_other_channels_as_logged(trace: Trace) -> None:
    recording = trace.recording
    stamps = recording.channel("position").stamps_ns
    both = replace(
        trace,
        recording=replace(
            recording, channels={**recording.channels, "sim_force": Channel("sim_force", "N", stamps, 0.0 * stamps)}
        ),
    )
    changed = change_recording(both, both.inputs.with_position(both.inputs.position + 0.001, both.rate_Hz))
    assert "sim_force" not in changed.channels
    np.testing.assert_allclose(
        changed.channel("position").values, recording.channel("position").values + 0.001, atol=1e-9
    )
    for name in ("force", "current"):
        np.testing.assert_array_equal(changed.channel(name).values, recording.channel(name).values)


def test_the_correction_gets_the_force_that_it_corrects(trace: Trace) -> None:
    weaker = trace.inputs.with_current(0.5 * trace.inputs.current)
    for inputs in (trace.inputs, weaker):
        np.testing.assert_allclose(Plant(CALLED, Tenth()).force(trace, inputs), 1.1 * CALLED.force(trace, inputs))


def test_effects_are_applied_from_inside_out_in_any_order(trace: Trace) -> None:
    spring, added, scale = Setting(Spring(), (2000.0,)), Setting(Added(), (50.0,)), Setting(Scale(), (2.0,))
    one, other = Composition((spring, added)), Composition((added, spring))
    np.testing.assert_allclose(Plant(CALLED).with_effects(one, trace), Plant(CALLED).with_effects(other, trace))
    scaled = Plant(CALLED).with_effects(Composition((added, scale)), trace)
    np.testing.assert_allclose(scaled, 2.0 * trace.simulated + 50.0)


def test_an_effect_on_the_input_reruns_and_outer_effects_get_its_inputs(trace: Trace) -> None:
    late = Late().drive(trace, trace.inputs, trace.simulated, (0.01,))
    both = Composition((Setting(Spring(), (2000.0,)), Setting(Late(), (0.01,))))
    expected = CALLED.force(trace, late) + 2000.0 * late.position
    np.testing.assert_allclose(Plant(CALLED).with_effects(both, trace), expected)


def test_outer_effects_drive_first(trace: Trace) -> None:
    late, gain = Setting(Late(), (0.01,)), Setting(CurrentGain(), (1.1,))
    inputs = Composition((gain, late)).drive(trace, trace.simulated)
    np.testing.assert_allclose(inputs.current, 1.1 * trace.inputs.current)
    moved = Late().drive(trace, trace.inputs, trace.simulated, (0.01,))
    np.testing.assert_allclose(inputs.position, moved.position)


@pytest.mark.parametrize(
    ("parameter", "value"),
    [
        (EffectParameter("a", -3.0, 5.0, (1.0,), ""), -2.5),
        (EffectParameter("b", 1e-6, 1e3, (1.0,), "", scale="log"), 3e-4),
        (EffectParameter("c", 1e3, 1e9, (1e5,), "", scale="inverse"), 2e6),
        (EffectParameter("d", 1e3, np.inf, (1e5,), "", scale="inverse", neutral=np.inf), np.inf),
    ],
    ids=["linear", "log", "inverse", "infinite"],
)
def test_a_search_variable_converts_back_inside_the_bounds(parameter: EffectParameter, value: float) -> None:
    low, high = parameter.search_bounds()
    searched = parameter.to_search(value)
    assert low <= searched <= high and np.isfinite([low, high]).all()
    assert parameter.to_value(searched) == pytest.approx(value)
    for beyond in (low - 1e3, high + 1e3):
        assert parameter.low <= parameter.to_value(beyond) <= parameter.high
