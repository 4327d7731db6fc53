"""A stroke as bad logs have it: jitter, gaps, lost, late and repeated samples, spikes, jumps, and both motions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MS = 1_000_000
OMEGA, AMPLITUDE_M = 30.0, 0.02

Columns = tuple[NDArray[np.int64], NDArray[np.float64], dict[str, NDArray[np.float64]]]


def rough_samples(seed: int, rate_Hz: float = 1000.0, count: int = 4000, jitter: float = 0.15) -> Columns:
    """Return stamps [ns], positions [m], and speeds [m/s] and accelerations [m/s2] by name, at about a rate."""
    dice, period = np.random.default_rng(seed), 1e9 / rate_Hz
    stamps = (np.arange(count) * period + dice.normal(0.0, jitter * period, count)).astype(np.int64)
    stamps[count // 4 :] += 60 * MS
    stamps[count // 2 :] += 20 * MS
    stamps[7 * count // 8 :] -= 400 * MS
    phase = 1e-9 * OMEGA * stamps
    positions = AMPLITUDE_M * np.sin(phase) + dice.normal(0.0, 15e-6, count)
    wild = dice.choice(count, count // 100, replace=False)
    positions[wild] += dice.choice([-0.2, 0.05, 9.0], count // 100)
    positions[2 * count // 3 :] += 0.06
    speeds = AMPLITUDE_M * OMEGA * np.cos(phase)
    accelerations = 0.3 - AMPLITUDE_M * OMEGA**2 * np.sin(phase) + dice.normal(0.0, 0.05, count)
    kept = dice.random(count) > 0.05
    stamps[np.flatnonzero(kept)[300]] = stamps[np.flatnonzero(kept)[299]]
    return stamps[kept], positions[kept], {"speed": speeds[kept], "acceleration": accelerations[kept]}
