"""What sensors log of a signal, and what the servo actuator makes of a command."""

from dataclasses import replace

import numpy as np
import pytest

from ces_data.waveforms.currents import ConstantLevel
from ces_rig.dampers.hydraulic.parameters import Damper, HydraulicDamper
from ces_rig.dampers.stepper import simulate
from ces_rig.drive import MOTION_SIZE, STROKE, STROKE_SPEED, ServoActuator, ServoNumbers, servo_step
from ces_rig.experiments.virtual import drive_damper, parse_experiment, run, simulate_truth, with_seed
from ces_rig.sensors import GRID_S, Sensor

TIME = np.arange(0, 30.0, 0.5e-3)
TRUE = 0.01 * np.sin(2 * np.pi * 3 * TIME)
EPOCH = 10**18


def measure(sensor, seed=1):
    return sensor.measure("position", "m", TIME, TRUE, EPOCH, np.random.default_rng(seed))


def true_at(channel):
    return 0.01 * np.sin(2 * np.pi * 3 * (channel.stamps_ns - EPOCH) * 1e-9)


def test_an_ideal_sensor_logs_the_signal():
    channel = measure(Sensor(phase_s=0.3e-3))
    assert len(channel) == 30_000
    assert channel.stamps_ns[0] == EPOCH + 300_000
    assert (np.diff(channel.stamps_ns) == 1_000_000).all()
    assert np.abs(channel.values - true_at(channel)).max() < 0.2e-6


def test_noise_and_quantum():
    channel = measure(Sensor(noise=15e-6, quantum=12e-6, bias=1e-3))
    error = channel.values - true_at(channel)
    assert error.mean() == pytest.approx(1e-3, abs=1e-6)
    assert error.std() == pytest.approx(np.hypot(15e-6, 12e-6 / np.sqrt(12)), rel=0.03)
    steps = channel.values / 12e-6
    assert steps == pytest.approx(np.round(steps), abs=1e-6)


def test_rate_jitter_and_order():
    channel = measure(Sensor(rate_Hz=200.0, jitter_s=30e-6))
    nominal = EPOCH + np.arange(len(channel)) * 5_000_000
    assert len(channel) == 6000
    assert (channel.stamps_ns - nominal).std() == pytest.approx(30_000, rel=0.05)
    wild = measure(Sensor(jitter_s=5e-3))
    assert (np.diff(wild.stamps_ns) >= 0).all()


def test_dropouts():
    channel = measure(Sensor(dropout=0.1))
    assert len(channel) == pytest.approx(27_000, abs=300)
    assert np.abs(channel.values - true_at(channel)).max() < 0.2e-6


def test_a_switched_signal_does_not_ring():
    switched = np.where(TIME < 10.0, 0.29, 0.70)
    values = Sensor(phase_s=0.2e-3).measure("current", "A", TIME, switched, EPOCH, np.random.default_rng(1)).values
    assert 0.29 - 1e-12 <= values.min() <= values.max() <= 0.70 + 1e-12


IDEAL = ServoActuator(disturbance_m=0.0, compliance_m_N=0.0)
SINE = {"kind": "sine", "amplitude_m": 0.012, "frequency_Hz": 4.0}
SHORT = {"duration_s": 1.5, "stroke": SINE, "current": {"kind": "constant", "current_A": 0.6}}


def repeated(experiment, repeat):
    return replace(experiment, settings=replace(experiment.settings, repeat=repeat))


def actuated(**actuator):
    return parse_experiment({**SHORT, "actuator": actuator}, "e.yaml")


def drive(servo, command, time):
    return drive_damper(Damper(), ConstantLevel(0.3), time, command, servo)[0].state("stroke_m")


@pytest.mark.parametrize("frequency", [2.0, 10.0, 30.0])
def test_the_response_is_that_of_its_transfer_function(frequency):
    time = np.arange(4001) * GRID_S
    command = 0.002 * np.sin(2 * np.pi * frequency * time)
    stroke = drive(replace(IDEAL, gain=0.9), command, time)[2000:4000]
    basis = np.exp(2j * np.pi * frequency * time[2000:4000])
    found = 2 * np.mean(stroke * basis.conj()) / 0.002 * 1j
    s = 2j * np.pi * frequency
    w = 2 * np.pi * IDEAL.bandwidth_Hz
    loop = (1 + IDEAL.valve_s * s) * (1 + 2 * IDEAL.damping * s / w + s**2 / w**2)
    assert found == pytest.approx(0.9 * np.exp(-s * IDEAL.delay_s) / loop, abs=0.01)


def test_the_damper_pushes_back_by_force_times_compliance():
    stiff, soft = (simulate_truth(actuated(disturbance_m=0.0, compliance_m_N=c)) for c in (0.0, 2e-7))
    difference = soft.stroke_m - stiff.stroke_m
    slow = -2e-7 * stiff.force_N
    assert np.abs(difference).max() > 3e-4
    assert np.corrcoef(difference[500:], slow[500:])[0, 1] > 0.9
    assert np.ptp(difference) == pytest.approx(np.ptp(slow), rel=0.3)


def test_no_command_breaks_the_limits_of_the_actuator():
    servo = replace(IDEAL, stroke_m=0.01, speed_m_s=0.3, acceleration_m_s2=20.0)
    numbers, motion = ServoNumbers(*servo.numbers()), np.zeros(MOTION_SIZE)
    random, step = np.random.default_rng(3), 50e-6
    speeds, positions = [0.0], []
    for _ in range(400):
        command = random.uniform(-0.05, 0.05)
        for _ in range(100):
            servo_step(numbers, motion, command, step)
            speeds.append(motion[STROKE_SPEED])
            positions.append(motion[STROKE])
    assert np.abs(positions).max() == 0.01
    assert np.abs(speeds).max() <= 0.3
    free = np.abs(positions[1:]) < 0.01
    assert np.abs(np.diff(speeds[1:]))[free].max() <= 20.0 * step * (1 + 1e-9)


@pytest.mark.slow
def test_repetitions_differ_by_the_disturbance_and_seeds_by_more():
    one = parse_experiment({**SHORT, "duration_s": 3.0, "actuator": {"compliance_m_N": 0.0}}, "e")
    first, again, other = (simulate_truth(e) for e in (one, repeated(one, 1), repeated(one, 2)))
    for difference in (again.stroke_m - first.stroke_m, other.stroke_m - again.stroke_m):
        assert np.std(difference) / 2**0.5 == pytest.approx(20e-6, rel=0.35)
    assert np.array_equal(simulate_truth(repeated(one, 1)).stroke_m, again.stroke_m)


def test_a_repetition_has_other_noise_and_the_same_stroke_and_current():
    noisy = {"stroke": {"kind": "noise", "peak_to_peak_m": 0.02}, "current": {"kind": "filtered_noise"}}
    one = parse_experiment({**SHORT, **noisy}, "e")
    truth, again = simulate_truth(one), simulate_truth(repeated(one, 3))
    assert np.array_equal(truth.stroke_m, again.stroke_m)
    assert np.array_equal(truth.commanded_A, again.commanded_A)
    assert not np.array_equal(run(one).channel("position").values, run(repeated(one, 3)).channel("position").values)
    assert not np.array_equal(truth.stroke_m, simulate_truth(with_seed(one, 9)).stroke_m)


def test_without_an_actuator_the_stroke_is_exact():
    truth = simulate_truth(parse_experiment(SHORT, "e"))
    assert np.array_equal(truth.stroke_m, truth.command_m)
    plain = simulate(HydraulicDamper(Damper()), GRID_S, truth.stroke_m, truth.commanded_A)
    assert np.array_equal(truth.force_N + 0.0, plain.force_N - (plain.force_N - truth.force_N)[0])


def test_the_command_is_logged_on_demand():
    recording = run(parse_experiment({**SHORT, "actuator": {}, "sensors": {"log_command": True}}, "e"))
    command, position = recording.channel("command"), recording.channel("position")
    assert command.values.max() == pytest.approx(0.012, abs=1e-4)
    assert np.abs(position.values[:1400] - command.values[:1400]).max() > 1e-3
    assert "command" not in run(actuated()).channels
