"""The share of time that recordings spend in each region of speed and current, which a model can learn from.

The speed here comes from a non-causal Savitzky-Golay filter, accurate enough for an overview; identification and
observer use the causal differentiator.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter

from ces_identify.numerics.arrays import F, I
from ces_identify.recordings.checks import SECOND
from ces_identify.recordings.recording import Channel, Recording

WINDOW_S = 0.02  # of the Savitzky-Golay filter, but at least MIN_SAMPLES samples
MIN_SAMPLES = 7
GAP_INTERVALS = 5.0  # longer intervals end a run; no speed is computed across them
RANGE_QUANTILE = 0.995  # of |speed|; higher speeds count in the outermost cells, so that spikes do not set the scale


@dataclass(frozen=True)
class Coverage:
    """Share of time in each cell of speed and current.

    `speed_edges` (m + 1,) [m/s] and `current_edges` (n + 1,) [A] bound the cells; `share` (n, m) sums to 1, or to 0
    without samples. `duration_s` is the time counted.
    """

    speed_edges: F
    current_edges: F
    share: F
    duration_s: float


def coverage(recordings: Sequence[Recording], speed_cells: int = 24, current_cells: int = 8) -> Coverage:
    """Count the time of recordings with position and current in cells of speed and current."""
    samples = [speed_current_samples(recording) for recording in recordings]
    speed, current, weight = (np.concatenate(parts) for parts in zip(*samples, strict=True))
    top = float(np.quantile(np.abs(speed), RANGE_QUANTILE)) if len(speed) else 0.0
    speed_edges = np.linspace(-1.0, 1.0, speed_cells + 1) * (top or 1.0)
    current_edges = _current_edges(current, current_cells)
    inside = np.clip(speed, speed_edges[0], speed_edges[-1])
    time, _, _ = np.histogram2d(current, inside, [current_edges, speed_edges], weights=weight)
    total = float(weight.sum())
    return Coverage(speed_edges, current_edges, time / total if total else time, total)


def speed_current_samples(recording: Recording) -> tuple[F, F, F]:
    """Return speed [m/s], current [A] and duration [s] of each sample (n,) where both are known."""
    times, speed, weight = _estimate_speed(recording.channel("position"))
    current = _hold_current(recording, times)
    known = np.isfinite(current) & np.isfinite(speed)
    return speed[known], current[known], weight[known]


def _estimate_speed(position: Channel) -> tuple[I, F, F]:
    """Return stamps [ns], speed and duration on a regular grid within each run of position without a gap."""
    good = np.isfinite(position.values)
    stamps, first = np.unique(position.stamps_ns[good], return_index=True)
    values = position.values[good][first]
    intervals = np.diff(stamps)
    if not len(intervals):
        return np.empty(0, np.int64), np.empty(0), np.empty(0)
    interval = max(1, int(np.median(intervals)))
    breaks = np.flatnonzero(intervals > GAP_INTERVALS * interval) + 1
    runs = zip(np.split(stamps, breaks), np.split(values, breaks), strict=True)
    grids = [_estimate_run_speed(run, x, interval) for run, x in runs if run[-1] - run[0] >= MIN_SAMPLES * interval]
    times = np.concatenate([grid for grid, _ in grids] or [np.empty(0, np.int64)])
    speed = np.concatenate([v for _, v in grids] or [np.empty(0)])
    return times, speed, np.full(len(times), interval / SECOND)


def _estimate_run_speed(stamps: I, values: F, interval: int) -> tuple[I, F]:
    grid = np.arange(stamps[0], stamps[-1] + 1, interval)
    even = np.interp((grid - stamps[0]).astype(np.float64), (stamps - stamps[0]).astype(np.float64), values)
    window = min(max(MIN_SAMPLES, 2 * round(WINDOW_S * SECOND / interval / 2) + 1), (len(grid) - 1) // 2 * 2 + 1)
    return grid, savgol_filter(even, window, polyorder=2, deriv=1, delta=interval / SECOND)


def _hold_current(recording: Recording, times: I) -> F:
    """Return the current at each time: the last one logged, NaN before the first."""
    if "current" in recording.constants:
        return np.full(len(times), recording.constants["current"])
    channel = recording.channel("current")
    order = np.argsort(channel.stamps_ns, kind="stable")
    last = np.searchsorted(channel.stamps_ns[order], times, side="right") - 1
    held = np.append(channel.values[order], np.nan)
    return held[last]


def _current_edges(current: F, cells: int) -> F:
    low, high = (float(current.min()), float(current.max())) if len(current) else (0.0, 0.0)
    if high - low < 1e-9 * max(1.0, abs(high)):
        return np.array([low - 0.05, high + 0.05])
    return np.linspace(low, high, cells + 1)
