"""Noise from standstill: where position and current rest, the force is constant but for noise and slow trends."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import toeplitz

from ces_gap.sensor_noise.cycles import correlate_neighbours
from ces_gap.sensor_noise.noise_estimate import STANDSTILL, F, GridSignals, NoiseEstimate

WINDOW_S = 0.5  # [s] in which the force may change quadratically
MIN_WINDOWS = 3
TREND = 5  # coefficients of the trend in a window
MAX_MOVE, MAX_MOVE_M = 1e-3, 10e-6  # spread of the position in a window: over that of the recording, or [m]
MAX_CURRENT = 0.02  # spread of the current in a window over its RMS


def estimate_from_standstill(signals: GridSignals) -> NoiseEstimate:
    """Return the RMS of the force about its trend in windows without motion, the median of the windows."""
    width = max(round(WINDOW_S * signals.rate_Hz), 16)
    starts = _find_still_windows(signals, width)
    if len(starts) < MIN_WINDOWS:
        return NoiseEstimate(STANDSTILL, 0.0, "the damper hardly ever rests")
    left = np.stack([_remove_trend(signals, slice(k, k + width)) for k in starts])
    energy = (left**2).sum(1)
    middle = left[np.argsort(energy)[len(energy) // 2]]
    lag1 = correlate_neighbours(middle, np.ones(width, bool))
    return NoiseEstimate(STANDSTILL, float(np.sqrt(np.median(energy) / _ticks_left(width, lag1))), lag1=lag1)


def _ticks_left(width: int, lag1: float) -> float:
    """Return the energy that a trend leaves of noise of 1 N, in ticks: it takes more of autocorrelated noise."""
    trend: F = np.linalg.qr(_polynomial(width))[0]
    correlation = toeplitz(max(lag1, 0.0) ** np.arange(width))
    return width - float(np.trace(trend.T @ correlation @ trend)) - TREND + len(trend[0])


def _polynomial(width: int) -> F:
    return np.vander(np.linspace(-1.0, 1.0, width), 3)


def _remove_trend(signals: GridSignals, window: slice) -> F:
    """Return the force in a window less a quadratic trend and what remains of position and speed in it."""
    force = signals.force[window]
    moved = np.stack([signals.position[window], signals.speed[window]], axis=1)
    rows = np.hstack([_polynomial(len(force)), (moved - moved.mean(0)) / np.maximum(moved.std(0), 1e-12)])
    return np.asarray(force - rows @ np.linalg.lstsq(rows, force, rcond=1e-9)[0])


def _find_still_windows(signals: GridSignals, width: int) -> list[int]:
    """Return the first ticks of windows without motion, none overlapping."""
    if len(signals.force) < width:
        return []
    move = max(MAX_MOVE * float(signals.position.std()), MAX_MOVE_M)
    current = MAX_CURRENT * float(np.sqrt(np.mean(signals.current**2)))
    still = sliding_window_view(signals.usable, width).all(1)
    still &= (_spreads(signals.position, width) <= move) & (_spreads(signals.current, width) <= current + 1e-9)
    starts, free = [], 0
    for start in np.flatnonzero(still):
        if start >= free:
            starts.append(int(start))
            free = int(start) + width
    return starts


def _spreads(values: F, width: int) -> F:
    """Return the standard deviation of `values` (n,) in each window (n - width + 1,)."""
    return np.asarray(sliding_window_view(values, width).std(1))
