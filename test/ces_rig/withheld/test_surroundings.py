"""Effects around the damper: a spool that sticks, a ripple that is not logged, a frame that rings."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim

from ces_rig.dampers.effects import WithheldEffect
from ces_rig.dampers.stepper import simulate
from ces_rig.errors import RigError
from ces_rig.sensors import GRID_S
from ces_rig.withheld.environment import hold_until_free
from ces_rig.withheld.plants import PLANTS, draw_plant, physical_numbers, simulate_signals

TIME = np.arange(1600) * GRID_S
STROKE = 0.015 * np.clip(5 * TIME, 0, 1) ** 2 * np.sin(2 * np.pi * 4 * TIME)


def plant_of(kind):
    return draw_plant(kind, np.random.default_rng(3))


def simulate_with(kind, effect, command):
    return simulate_signals(plant_of(kind), [effect] if effect else [], TIME, STROKE, command)


def test_a_spool_sticks_after_each_reversal_or_stop_until_the_threshold():
    held = hold_until_free(np.array([0.0, 0.05, 0.11, 0.2, 0.2, 0.12, 0.3, 0.31, 0.1]), 0.1)
    assert held.tolist() == [0.0, 0.0, 0.11, 0.2, 0.2, 0.2, 0.2, 0.31, 0.31]


@pytest.mark.parametrize("kind", PLANTS)
def test_a_sticking_spool_ignores_small_changes_of_current_that_are_logged(kind):
    low, high = plant_of(kind).current_A
    small = np.where(TIME > 0.4, 0.5 * high, 0.5 * high + 0.04 * (high - low))
    stuck = WithheldEffect("sticking_pilot", 1.0, {"threshold": 0.08})
    with_it, free, before = (
        simulate_with(kind, effect, command)
        for effect, command in ((stuck, small), (None, small), (None, small[:1] + 0 * TIME))
    )
    assert np.array_equal(with_it.coil_A, free.coil_A)
    after = TIME > 0.45
    assert np.abs(with_it.force_N - before.force_N)[after].max() < 2.0
    assert np.abs(with_it.force_N - free.force_N)[after].max() > 5.0


@pytest.mark.parametrize("kind", PLANTS)
def test_a_ripple_shows_in_the_force_alone(kind):
    high = plant_of(kind).current_A[1]
    ripple = WithheldEffect("current_ripple", 1.0, {"amplitude": 0.1, "frequency_Hz": 50.0, "phase_rad": 0.0})
    command = np.full_like(TIME, 0.5 * high)
    with_it, free = simulate_with(kind, ripple, command), simulate_with(kind, None, command)
    assert np.array_equal(with_it.coil_A, free.coil_A)
    change = (with_it.force_N - free.force_N)[400:1600]
    spectrum = np.abs(np.fft.rfft(change * np.sign(np.gradient(STROKE))[400:1600]))
    assert np.fft.rfftfreq(len(change), GRID_S)[1:][np.argmax(spectrum[1:])] == pytest.approx(50.0, abs=2.0)


@pytest.mark.parametrize("kind", PLANTS)
def test_the_frame_moves_as_its_equation_says_under_the_dampers_force(kind):
    """The damper's force on the frame's own motion, computed apart, gives the same force again."""
    frame = WithheldEffect("frame_resonance", 1.0, {"compliance_m_N": 2e-7, "frequency_Hz": 30.0, "damping": 0.05})
    high = plant_of(kind).current_A[1]
    plant = plant_of(kind).without_coil()
    command = np.full_like(TIME, 0.5 * high)
    true, free = (simulate_signals(plant, effects, TIME, STROKE, command) for effects in ([frame], []))
    w = 2.0 * np.pi * 30.0
    system = ([2e-7 * w * w], [1.0, 2.0 * 0.05 * w, w * w])
    deflection = lsim(system, true.force_N - true.force_N[0], TIME)[1]
    again = simulate(plant, GRID_S, STROKE - deflection, command).tared_N
    ringing = np.std(true.force_N - free.force_N)
    assert ringing > 3.0
    assert np.std(again - true.force_N) < 0.05 * ringing + 0.2
    assert np.array_equal(true.stroke_m, STROKE)


def test_a_frame_too_light_is_refused():
    frame = WithheldEffect("frame_resonance", 1.0, {"compliance_m_N": 1e-5, "frequency_Hz": 60.0, "damping": 0.05})
    assert physical_numbers(plant_of("bouc_wen"), replace(frame, severity=2.0))["compliance_m_N"] == 2e-5
    with pytest.raises(RigError, match="frame_resonance: mass is"):
        simulate_with("bouc_wen", frame, np.full_like(TIME, 0.5))
