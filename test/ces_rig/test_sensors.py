"""Sensors: noise, quantum, rate, phase, jitter and dropouts are what they are set to."""

import numpy as np
import pytest

from ces_rig.sensors import Sensor

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
