"""Traces made in memory for tests of where a gap lies: a known motion, a known force, and autocorrelated noise."""

from __future__ import annotations

import numpy as np
from made_recordings import recording_of
from scipy.signal import lfilter

from ces_data.arrays import F
from ces_gap.baseline.learner import NoiseModel
from ces_gap.grid import derivative
from ces_gap.trace import Trace, make_trace


def drive(seed: int = 1, seconds: float = 20.0, rate_Hz: float = 500.0, current: str = "steps") -> Trace:
    """A random stroke of a few hertz, and a current in steps; the force is a plain damper's without a gap."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * rate_Hz)) / rate_Hz
    position = np.zeros_like(time)
    for frequency in rng.uniform(0.3, 5.0, 12):
        position += 0.02 / 12**0.5 / frequency**0.7 * np.sin(2 * np.pi * (frequency * time + rng.random()))
    level = rng.choice([0.0, 0.5, 1.0, 1.6], size=int(seconds / 0.7) + 1)[(time / 0.7).astype(int)]
    return trace_of(time, position, level if current == "steps" else np.full_like(time, 0.8), f"drive{seed}")


def trace_of(time: F, position: F, current: F, name: str = "made") -> Trace:
    force = 1500.0 * derivative(position, 1.0 / (time[1] - time[0])) * (1.0 + current)
    return make_trace(recording_of(time, name, position=position, current=current, force=force), force)


def ar(rms_N: float, pole: float) -> NoiseModel:
    """First-order autoregressive noise."""
    return NoiseModel(rms_N, rms_N * float(np.sqrt(1.0 - pole**2)), np.array([pole]))


def ar_noise(n: int, rms_N: float, pole: float, rng: np.random.Generator) -> F:
    white = rng.normal(size=n + 500)
    return np.asarray(lfilter([rms_N * np.sqrt(1.0 - pole**2)], [1.0, -pole], white))[500:]
