"""Currents keep their ranges and times; one follows the stroke, and reg1 closes the loop over the damper."""

import numpy as np
import pytest

from ces_rig.dampers.hydraulic.parameters import Damper, HydraulicDamper
from ces_rig.dampers.stepper import simulate
from ces_rig.experiments.virtual import FORCES_N, KINDS, Reg1, SpeedForceLoop, drive_damper, make_current

STEP = 1e-3

TIME = np.arange(0, 20, STEP)

STROKE = 0.018 * np.sin(2 * np.pi * 2 * TIME)

EXAMPLES = [
    {"kind": "constant", "current_A": 0.5},
    {"kind": "ramp"},
    {"kind": "steps", "levels_A": [0.29, 0.5, 0.7]},
    {"kind": "prbs"},
    {"kind": "binary"},
    {"kind": "filtered_noise"},
    {"kind": "sine"},
    {"kind": "stroke_following"},
]


def samples(given, seed=1):
    return make_current(given, "x.yaml: current").samples(TIME, STROKE, np.random.default_rng(seed))


def test_examples_cover_every_kind():
    assert {e["kind"] for e in EXAMPLES} == set(KINDS) - {"reg1", "sequence"}  # reg1 below, test_sequences.py


@pytest.mark.parametrize("given", EXAMPLES, ids=lambda e: e["kind"])
def test_every_kind_is_seeded_and_inside_the_range(given):
    current = samples(given)
    assert current.shape == TIME.shape
    assert np.array_equal(current, samples(given))
    assert np.array_equal(current, samples(given, 2)) == (given["kind"] not in ("prbs", "binary", "filtered_noise"))
    assert 0.29 <= current.min() <= current.max() <= 0.70


def test_steps_are_held():
    current = samples({"kind": "steps", "levels_A": [0.3, 0.6], "hold_s": 2.0})
    assert current[TIME < 1.999] == pytest.approx(0.3)
    assert current[(TIME > 2.001) & (TIME < 3.999)] == pytest.approx(0.6)
    assert current[(TIME > 4.001) & (TIME < 5.999)] == pytest.approx(0.3)


def switch_gaps(current):
    return np.diff(TIME[1:][np.diff(current) != 0])


def test_prbs_switches_at_multiples_of_its_hold():
    gaps = switch_gaps(samples({"kind": "prbs", "hold_s": 0.1}))
    assert len(gaps) > 50
    assert gaps / 0.1 == pytest.approx(np.round(gaps / 0.1), abs=0.03)


def test_binary_holds_at_least_its_shortest_time():
    gaps = switch_gaps(samples({"kind": "binary", "shortest_s": 0.05, "mean_s": 0.2}))
    assert gaps.min() >= 0.05 - 2 * STEP
    assert gaps.mean() == pytest.approx(0.2, rel=0.25)


def test_filtered_noise_uses_its_range_and_its_band():
    current = samples({"kind": "filtered_noise", "cutoff_Hz": 2.0})
    assert np.ptp(current) > 0.25
    power = np.abs(np.fft.rfft(current - current.mean())) ** 2
    frequency = np.fft.rfftfreq(len(TIME), STEP)
    assert power[frequency > 6].sum() < 0.01 * power.sum()


def test_stroke_following_current_follows_with_a_small_lag():
    current = samples({"kind": "stroke_following", "lag_s": 0.01})
    lags = np.arange(0, 100)
    steady = slice(1000, -1000)
    likeness = [np.corrcoef(np.roll(STROKE, lag)[steady], current[steady])[0, 1] for lag in lags]
    assert max(likeness) > 0.98
    assert lags[int(np.argmax(likeness))] == pytest.approx(10, abs=3)


STEP_S = 0.5e-3

FINE_TIME = np.arange(0.0, 4.0, STEP_S)

FAST_STROKE = 0.0125 * np.sin(2 * np.pi * 4.0 * FINE_TIME) * np.minimum(FINE_TIME / 0.5, 1.0)

SPEED = np.gradient(FAST_STROKE, FINE_TIME)


def tracking_error_N(controller):
    """RMS of reference minus force where the motion is fast and the force has built up."""
    run, _ = drive_damper(Damper(), controller, FINE_TIME, FAST_STROKE)
    reference = np.array([controller.reference.at(v) for v in SPEED])
    fast = (np.abs(SPEED) > 0.2) & (FINE_TIME > 1.0)
    return float(np.sqrt(np.mean((run.tared_N - reference)[fast] ** 2)))


@pytest.mark.slow
def test_the_force_follows_the_reference_because_it_is_fed_back():
    forces_N = tuple(0.75 * force for force in FORCES_N)
    closed, constant = (tracking_error_N(Reg1(forces_N=forces_N, gain_A_N=gain)) for gain in (1.5e-4, 0.0))
    assert closed < 0.7 * constant
    assert closed < 80.0


def test_commands_stay_inside_the_range_and_make_the_run_s_force():
    run, command = drive_damper(Damper(), Reg1(), FINE_TIME, FAST_STROKE)
    assert 0.29 <= command.min() < 0.40
    assert 0.60 < command.max() <= 0.70
    again = simulate(HydraulicDamper(Damper()), STEP_S, FAST_STROKE, command)
    np.testing.assert_array_equal(run.force_N, again.force_N)


def test_the_integral_is_held_at_a_limit():
    loop = SpeedForceLoop(Reg1(), 1e-3, 0.0)
    for n in range(1, 2000):  # compression at 0.2 m/s without force: the reference is out of reach
        loop.step(0.2e-3 * n, 0.0)
    assert loop.current_A == 0.70
    settled = [loop.step(0.2e-3 * (2000 + n), 1200.0) for n in range(30)]
    assert settled[0] < 0.70, "no wind-up: the command leaves the limit at once"
    assert settled[-1] < settled[0]
