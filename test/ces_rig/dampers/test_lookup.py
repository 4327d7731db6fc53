"""The damper known by a table: what a recording of one teaches is that one, and what is no table is refused."""

from dataclasses import replace

import numpy as np
import pytest

from ces_data.recording import Channel
from ces_data.waveforms.strokes import make_stroke
from ces_rig.dampers.lookup.kernel import SPEEDS, TABLE, Lookup, learn_lookup
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
