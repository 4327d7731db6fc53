"""Traces: clean signals pass, gaps and transients are not usable, noise, rates and maps of the plant are correct."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from damper_models import delayed_damper
from engine_plant import NOISE_N, RATE_HZ, SIMULATION, recorded, traced
from input_physics import TABLE, plain, series
from input_physics import recorded as record_force

from ces_data.recording import Channel, Recording
from ces_gap.errors import GapError
from ces_gap.grid import GRID_HZ, bridge_gaps, find_low_pass_Hz, interpolate, smooth_out
from ces_gap.trace import Trace, TraceInputs, make_trace, open_trace, require_usable, smooth_recording
from ces_identify.simulations.simulation import ModelSimulation


def sine(rate_Hz: float = 1000.0, seconds: float = 4.0, noise_m: float = 0.0, force_N: float = 0.0) -> Recording:
    """A stroke of 2 Hz, its force in proportion to speed, and noise on both."""
    rng = np.random.default_rng(1)
    time = np.arange(round(rate_Hz * seconds)) / rate_Hz
    stamps = 10**18 + np.round(time * 1e9).astype(np.int64)
    position = 0.02 * np.sin(2.0 * np.pi * 2.0 * time) + noise_m * rng.standard_normal(len(time))
    force = 1000.0 * 0.04 * 2.0 * np.pi * np.cos(2.0 * np.pi * 2.0 * time) + force_N * rng.standard_normal(len(time))
    channels = {
        "position": Channel("position", "m", stamps, position),
        "force": Channel("force", "N", stamps, force),
        "current": Channel("current", "A", stamps[::20], np.full(len(stamps[::20]), 0.7)),
    }
    return Recording("sine", channels)


def of(recording: Recording) -> Trace:
    return make_trace(recording, np.zeros(len(recording.channel("position"))))


@pytest.mark.parametrize(("rate_Hz", "grid_Hz"), [(200.0, 200.0), (500.0, 500.0), (1000.0, 500.0), (2000.0, 500.0)])
def test_the_grid_is_the_logged_rate_thinned_to_at_most_about_its_own(rate_Hz: float, grid_Hz: float) -> None:
    trace = of(sine(rate_Hz))
    assert trace.rate_Hz == pytest.approx(grid_Hz) and trace.rate_Hz <= GRID_HZ
    np.testing.assert_allclose(np.diff(trace.time_s), trace.step_s)
    assert trace.grid_ns()[0] == 10**18 and trace.grid_ns()[-1] == 10**18 + round(trace.time_s[-1] * 1e9)


@pytest.mark.parametrize("rate_Hz", [500.0, 2000.0])
def test_motion_and_force_come_through_without_delay(rate_Hz: float) -> None:
    trace = of(sine(rate_Hz, noise_m=1e-5))
    w, t, use = 2.0 * np.pi * 2.0, trace.time_s, trace.usable
    np.testing.assert_allclose(trace.inputs.position[use], 0.02 * np.sin(w * t[use]), atol=2e-5)
    np.testing.assert_allclose(trace.inputs.speed[use], 0.02 * w * np.cos(w * t[use]), atol=0.01)
    np.testing.assert_allclose(trace.force[use], 1000.0 * 0.02 * w * np.cos(w * t[use]), atol=0.5)
    np.testing.assert_allclose(trace.inputs.current, 0.7)
    acceleration = -0.02 * w**2 * np.sin(w * t[use])
    assert np.corrcoef(trace.acceleration[use], acceleration)[0, 1] > 0.95


@pytest.mark.parametrize("rate_Hz", [500.0, 2000.0])
def test_the_noise_equals_the_simulated_noise(rate_Hz: float) -> None:
    trace = of(sine(rate_Hz, seconds=20.0, force_N=10.0))
    clean = of(sine(rate_Hz, seconds=20.0))
    true = (trace.force - clean.force)[trace.usable].std()
    assert trace.noise_N == pytest.approx(true, rel=0.07)
    assert clean.noise_N < 0.5


@pytest.mark.parametrize("signal", ["position", "force"])
def test_a_pause_of_a_channel_is_not_bridged_and_filters_settle_around_it(signal: str) -> None:
    recording = sine()
    channel = recording.channel(signal)
    time = (channel.stamps_ns - 10**18) * 1e-9
    lost = replace(channel, values=np.where((time > 1.0) & (time < 1.3), np.nan, channel.values))
    trace = of(replace(recording, channels={**recording.channels, signal: lost}))
    inside = (trace.time_s > 0.95) & (trace.time_s < 1.35)
    assert not trace.usable[inside].any()
    assert trace.usable[(trace.time_s > 0.2) & (trace.time_s < 0.8)].all()
    assert trace.usable[(trace.time_s > 1.5) & (trace.time_s < 3.8)].all()
    assert not trace.usable[trace.time_s < 0.05].any()
    assert all(np.isfinite(a).all() for a in (trace.force, trace.simulated, trace.inputs.position, trace.acceleration))


def test_force_that_was_not_measured_is_not_used_and_takes_no_edges_with_it() -> None:
    whole = sine(seconds=4.0)
    force = whole.channel("force")
    lost = (np.arange(len(force)) >= 2000) & (np.arange(len(force)) < 2030)
    holed = replace(force, values=np.where(lost, np.nan, force.values))
    trace = make_trace(replace(whole, channels={**whole.channels, "force": holed}), force.values)
    plain = make_trace(whole, force.values)
    at = np.round(trace.time_s * 1000).astype(int)
    np.testing.assert_array_equal(plain.usable & ~trace.usable, (at > 1998) & (at < 2031) & plain.usable)


def test_ticks_without_a_simulated_force_are_not_usable() -> None:
    recording = sine()
    simulated = np.where(np.arange(4000) < 2000, np.nan, 1.0)
    trace = make_trace(recording, simulated)
    assert (
        not trace.usable[trace.time_s < 2.0].any() and trace.usable[(trace.time_s > 2.2) & (trace.time_s < 3.8)].all()
    )


def test_a_recording_without_force_has_no_usable_tick() -> None:
    recording = sine()
    trace = of(replace(recording, channels={n: c for n, c in recording.channels.items() if n != "force"}))
    assert not trace.usable.any() and trace.noise_N == 0.0 and not trace.force.any()
    with pytest.raises(GapError, match=r"sine: 0\.00 s"):
        require_usable(trace)


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(GapError, match="expected at least 100"):
        of(sine(seconds=0.05))


def test_the_simulation_runs_on_the_smoothed_and_the_logged_position() -> None:
    recording = recorded()
    position = recording.channel("position")
    noisy = position.values + 2e-5 * np.random.default_rng(1).standard_normal(len(position))
    recording = replace(recording, channels={**recording.channels, "position": replace(position, values=noisy)})
    trace, clean = open_trace(SIMULATION, recording), traced()
    use = trace.usable
    given, smooth = (np.std((f - clean.simulated)[use]) for f in (trace.simulated_as_logged, trace.simulated))
    assert smooth < 0.5 * given
    once = open_trace(SIMULATION, recording, also_as_logged=False)
    np.testing.assert_array_equal(once.simulated, once.simulated_as_logged)
    np.testing.assert_allclose(once.simulated, trace.simulated, atol=1e-6)


def test_smoothing_keeps_motion_above_the_noise_of_the_position() -> None:
    rate_Hz, motion_Hz = 1000.0, 80.0
    time_s = np.arange(0.0, 10.0, 1.0 / rate_Hz)
    motion = 1e-4 * np.sin(2.0 * np.pi * motion_Hz * time_s)
    logged = motion + 1e-6 * np.random.default_rng(1).standard_normal(len(time_s))
    smooth = smooth_out(logged, find_low_pass_Hz(logged, rate_Hz), rate_Hz)
    middle = slice(1000, -1000)
    assert np.std((smooth - motion)[middle]) < 0.05 * np.std(motion)


def test_the_smoothed_recording_keeps_stamps_and_gaps() -> None:
    recording = recorded()
    position = recording.channel("position")
    holed = replace(position, values=np.where(np.arange(len(position)) == 700, np.nan, position.values))
    recording = replace(recording, channels={**recording.channels, "position": holed})
    made = smooth_recording(recording, of(recording)).channel("position")
    np.testing.assert_array_equal(made.stamps_ns, position.stamps_ns)
    assert np.flatnonzero(np.isnan(made.values)).tolist() == [700]
    inside = np.delete(np.arange(10, len(position) - 10), 690)
    np.testing.assert_allclose(made.values[inside], position.values[inside], atol=5e-5)


def test_a_changed_position_changes_the_speed_consistently() -> None:
    inputs = traced().inputs
    time = np.arange(len(inputs.position)) / RATE_HZ
    moved = inputs.with_position(inputs.position + 0.001 * np.sin(10.0 * time), RATE_HZ)
    np.testing.assert_allclose((moved.speed - inputs.speed)[3:-3], 0.01 * np.cos(10.0 * time[3:-3]), atol=1e-6)
    assert moved.current is inputs.current
    powered = inputs.with_current(2.0 * inputs.current)
    assert isinstance(powered, TraceInputs) and powered.position is inputs.position


def test_noise_of_the_test_damper_is_estimated() -> None:
    assert traced(seconds=20.0, constant_A=0.6).noise_N == pytest.approx(NOISE_N, rel=0.08)
    assert traced(seconds=20.0).noise_N == pytest.approx(NOISE_N, rel=0.15)  # steps of the force are not noise


def test_samples_out_of_order_are_sorted_and_one_alone_gives_nothing() -> None:
    seconds, values, grid = np.array([0.0, 2.0, 1.0, 1.0]), np.array([0.0, 4.0, 1.0, 9.0]), np.array([0.5, 1.5])
    for some in (seconds / 100.0, np.array([0.0, np.nan, np.nan, np.nan])):
        known = np.where(np.isfinite(some), values, np.nan)
        bridged, inside = bridge_gaps(seconds / 100.0, known, grid / 100.0)
        np.testing.assert_array_equal(bridged, interpolate(seconds / 100.0, known, grid / 100.0))
        np.testing.assert_allclose(bridged, [0.5, 2.5] if inside.all() else 0.0)
    assert not inside.any()


def test_the_unknown_end_of_a_model_with_a_delay_is_not_used() -> None:
    simulation = ModelSimulation(delayed_damper(0.02))
    recording = sine(seconds=4.0, noise_m=1e-5)
    force = simulation.force(recording)
    assert np.isnan(force[-20:]).all() and np.isfinite(force[-21])
    trace = open_trace(simulation, recording)
    assert np.isfinite(trace.simulated).all() and np.isfinite(trace.simulated_as_logged).all()
    assert not trace.usable[trace.time_s > 3.979].any()
    assert trace.usable[(trace.time_s > 1.0) & (trace.time_s < 3.8)].all()


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [9.5e5, 5e6])
def test_the_spring_of_a_plant_is_identified(stiffness: float) -> None:
    trace = record_force(series(TABLE / stiffness))
    compliance = replace(trace, simulated=trace.force).sprung_map.compliance
    assert 0.5 < compliance * stiffness < 2.0  # compliances are tried by factors of 1.8


def test_a_plant_without_a_spring_has_none() -> None:
    assert plain().sprung_map.compliance == 0.0


def test_a_map_is_learnt_once_for_a_trace_from_its_map_ticks() -> None:
    trace = plain()
    early = trace.usable & (trace.time_s < 0.5 * trace.time_s[-1])
    assert trace.sprung_map is trace.sprung_map
    part, judged = replace(trace, usable=early), replace(trace, usable=trace.usable & ~early, map_ticks=early)
    np.testing.assert_array_equal(judged.sprung_map.map.table, part.sprung_map.map.table)
    assert not np.array_equal(judged.sprung_map.map.table, trace.sprung_map.map.table)
