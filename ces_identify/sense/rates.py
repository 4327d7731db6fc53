"""A rate too low for what a recording holds: the force changes more between its samples than a model may err.

Half of the samples are interpolated from the other half. By how much they miss is what is lost at half the rate, and
shows what is lost at this one. A slow sine at 50 Hz passes, a road at 50 Hz does not.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.interpolate import CubicSpline

from ces_identify.recordings.checks import WARNING, WRONG_MODEL, Finding, mean_rate
from ces_identify.recordings.recording import Channel, Recording
from ces_identify.sense.force_map import is_constant

MAX_CHECKED_HZ = 400.0  # above it, what is lost is the noise of the load cell
MIN_SAMPLES = 64
MISS, WRONG_MISS = 0.2, 0.6  # of the force's RMS; free runs erred by 0.35 to 0.5 of it
VALVE_S = 0.005  # of the fastest valves; the slowest answer within 0.03 s
MIN_VALVE_HZ = 0.5 / VALVE_S
SIDE = 3  # samples on each side that must have no gap between them


def rate_findings(recording: Recording) -> Iterator[Finding]:
    """Yield a finding if the rate is too low for the force, or else for the response of the valve."""
    force, current = recording.channels.get("force"), recording.channels.get("current")
    rate = mean_rate(force) if force is not None else 0.0
    if force is None or not 0.0 < rate < MAX_CHECKED_HZ:
        return
    miss = interpolation_miss(force)
    if miss > MISS:
        yield Finding(
            WRONG_MODEL if miss > WRONG_MISS else WARNING,
            f"force: changes too fast for {rate:.0f} Hz: half of its samples, interpolated from the others, miss by "
            f"{miss:.0%} of its RMS, and a model will err by a third to half of that; oil and valves change a force "
            "within 5 to 30 ms: record at 500 Hz or more",
            signal="force",
        )
    elif rate < MIN_VALVE_HZ and current is not None and not is_constant(_finite(current)):
        yield Finding(
            WARNING,
            f"force: {rate:.0f} Hz is too low for the response of a valve, 5 to 30 ms: a model cannot learn how the "
            "force follows the current; record at 500 Hz or more",
            signal="force",
        )


def interpolation_miss(channel: Channel) -> float:
    """Return the RMS error of every second sample, interpolated from the others, relative to the channel's own.

    Samples beside gaps do not count; NaN if too few are left, or if the channel is constant.
    """
    good = np.isfinite(channel.values)
    stamps, first = np.unique(channel.stamps_ns[good], return_index=True)
    values = channel.values[good][first]
    if len(values) < MIN_SAMPLES or np.ptp(values) == 0.0:
        return np.nan
    time = (stamps - stamps[0]) * 1e-9
    odd = np.arange(SIDE, len(time) - SIDE)[(np.arange(SIDE, len(time) - SIDE) % 2) == 1]
    odd = odd[time[odd + SIDE] - time[odd - SIDE] < 4.0 * SIDE * float(np.median(np.diff(time)))]
    if len(odd) < MIN_SAMPLES // 4:
        return np.nan
    errors = CubicSpline(time[::2], values[::2])(time[odd]) - values[odd]
    return float(np.sqrt(np.mean(errors**2)) / values.std())


def _finite(channel: Channel) -> np.ndarray:
    return np.asarray(channel.values[np.isfinite(channel.values)])
