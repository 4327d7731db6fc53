"""Dampers with lumped parts: a table that is learned, kernels that converge and remember."""

from dataclasses import replace

import numpy as np
import pytest

from ces_data.recording import Channel
from ces_data.waveforms.strokes import make_stroke
from ces_rig.dampers.bouc_wen.kernel import BoucWen
from ces_rig.dampers.lookup.kernel import SPEEDS, TABLE, Lookup, learn_lookup
from ces_rig.dampers.stepper import KINDS as ALL
from ces_rig.dampers.stepper import simulate
from ces_rig.errors import RigError
from ces_rig.sensors import GRID_S, Sensors, Truth, measure_signals

PLANTED = Lookup(rise_s=7e-3, fall_s=7e-3, oil_N_m=2e6, speed_m_s=0.9, rebound=1.3)


@pytest.fixture(scope="module")
def recorded():
    time = np.arange(0.0, 15.0, GRID_S)
    noise = {"kind": "noise", "peak_to_peak_m": 0.06, "cutoff_Hz": 8.0}
    stroke = make_stroke(noise, "x").samples(time, np.random.default_rng(1))
    command = np.repeat(np.random.default_rng(2).uniform(0.2, 1.6, len(time) // 250 + 1), 250)[: len(time)]
    run = simulate(PLANTED, GRID_S, stroke, command)
    true = Truth(time, stroke, command, run.coil_A, run.tared_N, run.temperature_degC)
    return measure_signals(true, Sensors(), 1, "lab"), true


@pytest.mark.slow
def test_a_damper_learnt_from_a_recording_has_its_force(recorded):
    recording, true = recorded
    learnt = learn_lookup(recording)
    force = simulate(learnt.without_coil(), GRID_S, true.stroke_m, true.coil_A).tared_N
    assert np.std(force - true.force_N) < 0.1 * np.std(true.force_N)
    assert learnt.low_A < 0.25 and learnt.high_A > 1.5
    assert 0.004 <= learnt.rise_s <= 0.012


def test_what_teaches_no_map_is_refused(recorded):
    recording, _ = recorded
    channels = dict(recording.channels)
    force, current = channels["force"], channels["current"]
    wrong = replace(recording, channels={**channels, "force": replace(force, values=force.values[::-1])})
    with pytest.raises(RigError, match=r"lab: speed and current explain .* %? ?of its force; expected at least 70%"):
        learn_lookup(wrong)
    steady = Channel("current", "A", current.stamps_ns, np.full(len(current.values), 0.5))
    with pytest.raises(RigError, match=r"currents from 0\.5 to 0\.5 A; expected several"):
        learn_lookup(replace(recording, channels={**channels, "current": steady}))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"table": TABLE[:-1]}, "expected 4 rows of 9 forces that rise with the speed"),
        ({"table": TABLE[: len(SPEEDS)][::-1] + TABLE[len(SPEEDS) :]}, "forces that rise with the speed"),
        ({"low_A": 2.0}, "expected more than low_A, 2"),
    ],
)
def test_what_is_no_table_is_refused(change, says):
    with pytest.raises(RigError, match=says):
        Lookup(**change)


GRID = 0.5e-3


def drive(high_A, seconds=1.0, amplitude=0.02, frequency=3.0):
    time = np.arange(0, seconds, GRID)
    rise = np.clip(time / 0.1, 0, 1)
    stroke = amplitude * rise**2 * (3 - 2 * rise) * np.sin(2 * np.pi * frequency * time)
    return time, stroke, high_A * (0.5 + 0.4 * np.sin(2 * np.pi * 4.3 * time))


def relative_rms(a, b):
    return np.sqrt(np.mean((a - b) ** 2)) / np.std(b)


HIGH_A = {BoucWen: 1.6, Lookup: 1.6}


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "high"), list(HIGH_A.items()))
def test_half_the_step_gives_the_same_force(kind, high):
    _, stroke, current = drive(high)
    force = simulate(kind(), GRID, stroke, current).tared_N
    half = 0.5 * ALL[kind.kind].kernel.STEP_S
    assert 0.0 < relative_rms(force, simulate(kind(), GRID, stroke, current, step_s=half).tared_N) < 0.01


@pytest.mark.parametrize(("kind", "high"), list(HIGH_A.items()))
def test_more_field_damps_more_and_at_rest_nothing_but_gas_pushes(kind, high):
    _, stroke, _ = drive(high)
    energy = [
        float(np.dot(simulate(kind(), GRID, stroke, np.full_like(stroke, share * high)).tared_N, np.gradient(stroke)))
        for share in (0.1, 0.5, 1.0)
    ]
    assert 0 < energy[0] < 0.8 * energy[1] < 0.8 * energy[2]
    still = np.full(2000, 0.01)
    force = simulate(kind(), GRID, still, np.full(2000, high)).tared_N
    assert force[-1] > 0 and force[-1] == pytest.approx(force[1000], abs=1.0)


def test_the_mr_dampers_coil_lags_and_can_be_left_out():
    _, stroke, current = drive(1.6)
    coil = simulate(BoucWen(coil_s=5e-3), GRID, stroke, current).coil_A
    assert relative_rms(coil, current) > 0.05
    bare = simulate(BoucWen(coil_s=5e-3).without_coil(), GRID, stroke, current).coil_A
    assert np.abs(bare - current).max() < 2e-3  # half a step of the integrator


@pytest.mark.parametrize("kind", HIGH_A)
def test_a_gas_too_small_is_refused(kind):
    with pytest.raises(RigError, match="cannot take up the rod's volume"):
        kind(gas_m3=1e-6)
