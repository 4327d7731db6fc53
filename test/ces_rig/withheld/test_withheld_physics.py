"""What withheld effects do is what their physics says, in each plant that has them and around it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim

from ces_rig.dampers.hydraulic.parameters import HydraulicDamper
from ces_rig.dampers.model import WithheldEffect
from ces_rig.dampers.stepper import simulate
from ces_rig.errors import RigError
from ces_rig.sensors import GRID_S
from ces_rig.withheld.plants import (
    PLANTS,
    draw_effect,
    draw_plant,
    physical_numbers,
    scale_to_gap,
    simulate_signals,
)

pytestmark = pytest.mark.slow

FREQUENCY = 2.0


def sine(amplitude=0.02, frequency=FREQUENCY, seconds=1.5, share=0.5, kind="bouc_wen"):
    time = np.arange(round(seconds / GRID_S)) * GRID_S
    rise = np.clip(time / 0.25, 0, 1)
    low, high = plant_of(kind).current_A
    stroke = amplitude * rise**2 * (3 - 2 * rise) * np.sin(2 * np.pi * frequency * time)
    return time, stroke, np.full_like(time, low + share * (high - low))


def plant_of(kind):
    return draw_plant(kind, np.random.default_rng(3))


def added(kind, name, severity, inputs, seed=1):
    """Force [N] with the effect less that without, after the start."""
    plant = plant_of(kind)
    effect = replace(draw_effect(kind, name, np.random.default_rng(seed)), severity=severity)
    return (
        simulate_signals(plant, [effect], *inputs).force_N - simulate_signals(plant, (), *inputs).force_N
    ), physical_numbers(plant, effect)


def projected(values, part):
    return float(np.dot(values, part) / np.dot(part, part))


def pushes(kind, name, severity, **drive):
    """Added force [N], stroke, speed and acceleration after the start, and the effect's numbers."""
    inputs = sine(kind=kind, **drive)
    force, numbers = added(kind, name, severity, inputs)
    speed = np.gradient(inputs[1], GRID_S)
    settled = inputs[0] > 0.5
    return *(v[settled] for v in (force, inputs[1], speed, np.gradient(speed, GRID_S))), numbers


@pytest.mark.parametrize("kind", PLANTS)
def test_effects_push_along_stroke_speed_or_acceleration(kind):
    force, _, _, acceleration, numbers = pushes(kind, "inertia", 1.0)
    mass = next(value for name, value in numbers.items() if "mass" in name)
    extra = mass - plant_of(kind).number("body.moving_mass_kg" if kind == "hydraulic" else "mass_kg")
    assert projected(force, acceleration) == pytest.approx(extra, rel=0.1), "a mass adds mass times acceleration"
    force, _, speed, *_ = pushes(kind, "friction", 1.0)
    moving = np.abs(speed) > 0.1
    assert 15 < (force * np.sign(speed))[moving].mean() < 120, "friction opposes the motion"
    force, *_ = pushes(kind, "leakage", 1.0)
    assert (force * np.sign(speed))[moving].mean() < -10, "a leak yields to the motion"
    force, stroke, speed, *_ = pushes(kind, "gas_spring", 1.0, frequency=0.5, seconds=4.0)
    assert projected(force, stroke) > 100, "a stiffer gas pushes in proportion to the stroke [N/m]"
    assert np.std(projected(force, stroke) * stroke) > 2 * np.std(projected(force, speed) * speed)
    for name in ("compressibility", "mount_compliance"):  # springs in series turn the force towards the stroke
        force, stroke, speed, *_ = pushes(kind, name, 3.0, amplitude=0.01, frequency=5.0)
        assert projected(force, stroke) > 0 > projected(force, speed), name


@pytest.mark.parametrize("kind", PLANTS)
def test_play_lets_the_force_dwell_at_nothing_after_each_reversal(kind):
    inputs = sine(amplitude=0.01, kind=kind)
    plant = plant_of(kind)
    play = replace(draw_effect(kind, "backlash", np.random.default_rng(1)), severity=3.0)
    with_play, without = (simulate_signals(plant, effects, *inputs).force_N for effects in ([play], ()))
    number = plant.number
    area = plant.damper.rod_area_m2 if kind == "hydraulic" else number("rod_m2")
    gas = area * (number("reservoir.pressure_Pa" if kind == "hydraulic" else "gas_Pa") - 101_325)  # tared away
    settled = inputs[0] > 0.5
    dwell = [np.mean(np.abs(force[settled] + gas) < 6.0) for force in (with_play, without)]
    assert dwell[0] > 2 * dwell[1] + 0.01


@pytest.mark.parametrize("kind", PLANTS)
def test_blow_off_takes_only_from_large_forces(kind):
    inputs = sine(amplitude=0.03, kind=kind, share=0.9)
    plant = plant_of(kind)
    gap_N = 80.0  # below 60 N, the hydraulic valve opens now in this cycle, now in that: the gap jumps
    effect = scale_to_gap(plant, draw_effect(kind, "blow_off", np.random.default_rng(1)), gap_N, *inputs)
    free = simulate_signals(plant, (), *inputs).force_N
    change = simulate_signals(plant, [effect], *inputs).force_N - free
    large = np.abs(free) > 0.8 * np.abs(free).max()
    assert (change * np.sign(free))[large].mean() < -20
    small = np.abs(free) < 0.2 * np.abs(free).max()
    assert np.abs(change[small]).mean() < 0.4 * np.abs(change[large]).mean()


@pytest.mark.parametrize("kind", PLANTS)
def test_the_bump_stop_acts_near_the_ends_alone(kind):
    inputs = sine(amplitude=0.03, kind=kind)
    effect = scale_to_gap(plant_of(kind), draw_effect(kind, "bump_stop", np.random.default_rng(1)), 30.0, *inputs)
    force, numbers = added(kind, "bump_stop", effect.severity, inputs)
    clearance = next(value for name, value in numbers.items() if "clearance" in name)
    assert 0.015 < clearance < 0.03
    inside = np.abs(inputs[1]) < 0.4 * clearance
    outside = np.abs(inputs[1]) > clearance
    assert np.sqrt(np.mean(force[outside] ** 2)) > 10 * np.sqrt(np.mean(force[inside] ** 2))
    assert (force * inputs[1])[outside].sum() > 0


@pytest.mark.parametrize("kind", PLANTS)
def test_heat_fades_the_damping_with_time(kind):
    inputs = sine(amplitude=0.03, seconds=6.0, kind=kind)
    plant = plant_of(kind)
    effect = replace(draw_effect(kind, "temperature_fade", np.random.default_rng(1)), severity=3.0)
    hot, cold = simulate_signals(plant, [effect], *inputs), simulate_signals(plant, (), *inputs)
    assert hot.oil_degC[-1] > cold.oil_degC[-1] + 5
    early, late = (slice(round(a / GRID_S), round((a + 0.5) / GRID_S)) for a in (0.5, 5.5))
    ratio = [np.std(hot.force_N[part]) / np.std(cold.force_N[part]) for part in (early, late)]
    assert ratio[1] < ratio[0] - 0.01


@pytest.mark.parametrize("kind", PLANTS)
def test_a_slower_valve_is_late_both_ways_and_hysteresis_stays(kind):
    time, stroke, _ = sine(amplitude=0.03, frequency=1.0, seconds=1.0, kind=kind)
    low, high = plant_of(kind).current_A
    command = np.where((time > 0.4) & (time < 0.55), high, low)  # in rebound
    up, down = (time > 0.405) & (time < 0.415), (time > 0.555) & (time < 0.565)
    lag, _ = added(kind, "valve_lag", 1.0, (time, stroke, command))
    free = simulate_signals(plant_of(kind), (), time, stroke, command).force_N
    assert (lag * np.sign(free))[up].mean() < -5 < 5 < (lag * np.sign(free))[down].mean()
    assert np.abs(lag[(time > 0.53) & (time < 0.55)]).max() < 40
    middle = 0.5 * (low + high)
    ramps = [np.interp(time, [0, 0.2, 0.3], [start, start, middle]) for start in (low, high)]
    rows = [added(kind, "current_hysteresis", 2.0, (time, stroke, ramp))[0] for ramp in ramps]
    held = (time > 0.38) & (time < 0.45)
    assert -rows[0][held].mean() < -rows[1][held].mean() - 5  # the force is negative in rebound


def test_oil_boils_before_cavitation_costs_8_newtons():
    plant = plant_of("hydraulic")
    inputs = sine(amplitude=0.03, frequency=3.0, kind="hydraulic")
    for seed in range(3):
        effect = scale_to_gap(plant, draw_effect("hydraulic", "cavitation", np.random.default_rng(seed)), 8.0, *inputs)
        damper = plant.with_numbers(physical_numbers(plant, effect)).damper
        below = damper.oil.vapour_pressure_Pa + 2e3
        chamber = simulate(HydraulicDamper(damper), GRID_S, *inputs[1:]).state("p_compression_Pa")
        assert np.mean(chamber < below) > 0.005
        assert simulate(HydraulicDamper(plant.damper), GRID_S, *inputs[1:]).state("p_compression_Pa").min() > 5e4


def test_foam_builds_up_and_a_groove_has_its_place():
    inputs = sine(amplitude=0.03, seconds=4.0, kind="hydraulic")
    force, _ = added("hydraulic", "foaming", 1.0, inputs)
    early, late = force[round(0.5 / GRID_S) : round(1.0 / GRID_S)], force[round(3.5 / GRID_S) :]
    assert np.std(late) > 1.3 * np.std(early)
    for kind in PLANTS:
        inputs = sine(amplitude=0.03, kind=kind)
        effect = scale_to_gap(plant_of(kind), draw_effect(kind, "groove", np.random.default_rng(1)), 30.0, *inputs)
        force, numbers = added(kind, "groove", effect.severity, inputs)
        at = numbers.get("groove_at_m", numbers.get("extras.groove_at"))
        near, far = np.abs(inputs[1] - at) < 0.005, np.abs(inputs[1] - at) > 0.025
        assert np.std(force[near]) > 2 * np.std(force[far])


TIME = np.arange(1600) * GRID_S

STROKE = 0.015 * np.clip(5 * TIME, 0, 1) ** 2 * np.sin(2 * np.pi * 4 * TIME)


def simulate_with(kind, effect, command):
    return simulate_signals(plant_of(kind), [effect] if effect else [], TIME, STROKE, command)


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
