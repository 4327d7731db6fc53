"""Recordings of dampers with a known law, as a dyno would make them."""

from __future__ import annotations

import numpy as np

from ces import Recording
from ces_data.waveforms.strokes import make_stroke

RATE = 1000.0


def sine_motion(amplitude_m=0.02, frequency_Hz=2.0, duration_s=6.0, rate_Hz=RATE):
    """Return times, positions and speeds of a sine."""
    t = np.arange(0.0, duration_s, 1.0 / rate_Hz)
    omega = 2.0 * np.pi * frequency_Hz
    return t, amplitude_m * np.sin(omega * t), amplitude_m * omega * np.cos(omega * t)


def triangle_motion(duration_s=12.0, speed_m_s=0.2):
    """Return times, positions and speeds of a triangle of 30 mm."""
    t = np.arange(0.0, duration_s, 1.0 / RATE)
    shape = {"kind": "triangle", "amplitude_m": 0.03, "speed_m_s": speed_m_s, "fade_s": 0.0}
    x = make_stroke(shape, "test").samples(t, np.random.default_rng(0))
    return t, x, np.gradient(x, t)


def recording_of(t, x, current, force, noise_N=0.0, noise_m=0.0, seed=1, name="dyno"):
    """Return the recording of a damper with white noise on force and position."""
    rng = np.random.default_rng(seed)
    position = x + noise_m * rng.standard_normal(len(t))
    currents = np.broadcast_to(np.asarray(current, np.float64), t.shape)
    return Recording.from_arrays(t, position, currents, force + noise_N * rng.standard_normal(len(t)), name=name)


def lagging_force(t, steady, changes, time_constant_s, dead_time_s):
    """Return a force that follows `steady` (levels from `changes` on) as a first-order lag with a dead time."""
    force = np.full(len(t), steady[0])
    for at, before, after in zip(changes, steady[:-1], steady[1:], strict=True):
        late = t - at - dead_time_s
        force = np.where(
            late >= 0.0, after + (before - after) * np.exp(-np.maximum(late, 0.0) / time_constant_s), force
        )
    return force


def stepped_dyno(response, noise_N=8.0, seed=1):
    """Return a triangle with steps of the current in mid-stroke; `response` is the share of each change over time."""
    t, x, v = triangle_motion(duration_s=18.0)
    current = np.array([0.3, 0.7, 0.3, 0.3, 0.7, 0.3])[np.floor(t / 0.3 + 1e-9).astype(int) % 6]
    level = current.copy()
    for at in np.flatnonzero(np.diff(current)) + 1:
        after = slice(at, np.searchsorted(t, t[at] + 0.29))
        level[after] = current[at - 1] + (current[at] - current[at - 1]) * response(t[after] - t[at])
    force = (400.0 + 2000.0 * (level - 0.3)) * np.tanh(v / 0.01)
    return recording_of(t, x, current, force, noise_N, seed=seed)


HELD_A, HYSTERESIS_A = (0.3, 0.5, 0.7, 0.9, 0.7, 0.5, 0.3), 0.04  # by which the valve's current stays behind
POINTS = ((0.025, 0.131), (0.025, 0.262), (0.05, 0.524))  # amplitude [m] and peak speed [m/s]


def bench_programme(noise_N=0.0, noise_m=0.0, gas_N=0.0, seed=5):
    """Return sines at three target speeds, each with rising, then falling currents and a valve with hysteresis."""
    parts = []
    for amplitude, speed in POINTS:
        t, omega = np.arange(0.0, 6.0 * 2.0 * np.pi * amplitude / speed, 1.0 / RATE), speed / amplitude
        for n, current in enumerate(HELD_A):
            valve = current - HYSTERESIS_A * np.sign(3.5 - n) * (n > 0)
            v = speed * np.sin(omega * t)
            force = valve_force(valve, v) + gas_N
            parts.append((-amplitude * np.cos(omega * t), np.full(len(t), current), force))
    x, current, force = (np.concatenate(part) for part in zip(*parts, strict=True))
    return recording_of(np.arange(len(x)) / RATE, x, current, force, noise_N, noise_m, seed)


def valve_force(current, v):
    """Return the force [N] of the valve of `bench_programme`."""
    return 1500.0 * current * np.tanh(v / 0.1) * np.where(v < 0.0, 1.5, 1.0) + 300.0 * v
