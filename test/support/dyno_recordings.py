"""Recordings of dampers with a known law, as a dyno would make them."""

from __future__ import annotations

import numpy as np

from ces_data.waveforms.strokes import make_stroke
from ces_identify import make_recording

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
    return make_recording(t, position, currents, force + noise_N * rng.standard_normal(len(t)), name=name)


def lagging_force(t, steady, changes, time_constant_s, dead_time_s):
    """Return a force that follows `steady` (levels from `changes` on) as a first-order lag with a dead time."""
    force = np.full(len(t), steady[0])
    for at, before, after in zip(changes, steady[:-1], steady[1:], strict=True):
        late = t - at - dead_time_s
        force = np.where(
            late >= 0.0, after + (before - after) * np.exp(-np.maximum(late, 0.0) / time_constant_s), force
        )
    return force
