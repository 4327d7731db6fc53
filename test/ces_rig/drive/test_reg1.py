"""The controller reg1: it closes the loop over the damper, keeps to its range and follows its reference curve."""

import numpy as np
import pytest

from ces_rig.dampers.hydraulic.parameters import Damper, Hydraulic
from ces_rig.dampers.stepper import simulate
from ces_rig.drive.currents import FORCES_N, Reg1, SpeedForceLoop, make_current
from ces_rig.errors import RigError
from ces_rig.experiment import drive_damper

STEP_S = 0.5e-3
TIME = np.arange(0.0, 4.0, STEP_S)
STROKE = 0.0125 * np.sin(2 * np.pi * 4.0 * TIME) * np.minimum(TIME / 0.5, 1.0)
SPEED = np.gradient(STROKE, TIME)


SOFTER = tuple(0.75 * force for force in FORCES_N)


def tracking_error_N(controller):
    """RMS of reference minus force where the motion is fast and the force has built up."""
    run, _ = drive_damper(Damper(), controller, TIME, STROKE)
    reference = np.array([controller.reference.at(v) for v in SPEED])
    fast = (np.abs(SPEED) > 0.2) & (TIME > 1.0)
    return float(np.sqrt(np.mean((run.tared_N - reference)[fast] ** 2)))


@pytest.mark.parametrize("forces_N", [FORCES_N, SOFTER])
def test_the_force_follows_the_reference_because_it_is_fed_back(forces_N):
    closed, constant = (tracking_error_N(Reg1(forces_N=forces_N, gain_A_N=gain)) for gain in (1.5e-4, 0.0))
    assert closed < 0.7 * constant
    assert closed < 80.0


def test_commands_stay_inside_the_range_and_make_the_run_s_force():
    run, command = drive_damper(Damper(), Reg1(), TIME, STROKE)
    assert 0.29 <= command.min() < 0.40
    assert 0.60 < command.max() <= 0.70
    again = simulate(Hydraulic(Damper()), STEP_S, STROKE, command)
    np.testing.assert_array_equal(run.force_N, again.force_N)


def test_another_damper_gets_other_commands_for_nearly_the_same_force():
    weak = Damper()
    weak = type(weak)(ces_valve=type(weak.ces_valve)(cracking_high_Pa=3.2e6))
    commands = [drive_damper(damper, Reg1(), TIME, STROKE)[1] for damper in (Damper(), weak)]
    fast = (np.abs(SPEED) > 0.2) & (TIME > 1.0)
    assert np.mean((commands[1] - commands[0])[fast]) > 0.01


def test_the_integral_is_held_at_a_limit():
    loop = SpeedForceLoop(Reg1(), 1e-3, 0.0)
    for n in range(1, 2000):  # compression at 0.2 m/s without force: the reference is out of reach
        loop.step(0.2e-3 * n, 0.0)
    assert loop.current_A == 0.70
    settled = [loop.step(0.2e-3 * (2000 + n), 1200.0) for n in range(30)]
    assert settled[0] < 0.70, "no wind-up: the command leaves the limit at once"
    assert settled[-1] < settled[0]


def test_a_reference_that_drives_the_motion_is_refused():
    given = {"kind": "reg1", "speeds_m_s": [-0.1, 0.0, 0.1], "forces_N": [-10.0, 0.0, -5.0]}
    with pytest.raises(RigError, match=r"x.yaml: current: curve: -5 N at 0\.1 m/s would drive the motion"):
        make_current(given, "x.yaml: current")
