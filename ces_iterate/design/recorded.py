"""What a rig really did: a recording goes in, its stroke and current on the grid of the commands come out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from ces_identify.preparation.series import hold_current
from ces_identify.recordings.recording import Recording
from ces_iterate.commands import INTERVAL_S, Commands

F = NDArray[np.float64]

SMOOTHING = 21  # grid points of the quadratic smoothing of the stroke
MAX_AGE_S = 1.0  # of a current that is held


def recorded_commands(recording: Recording) -> Commands:
    """Return the smoothed stroke and the held current of a recording; gaps are bridged by straight lines."""
    position = recording.channel("position")
    good = np.isfinite(position.values)
    stamps, first = np.unique(position.stamps_ns[good], return_index=True)
    grid = np.arange(stamps[0], stamps[-1] + 1, round(INTERVAL_S * 1e9))
    time = (grid - stamps[0]).astype(np.float64)
    stroke = np.interp(time, (stamps - stamps[0]).astype(np.float64), position.values[good][first])
    current = hold_current(recording, grid, MAX_AGE_S)
    known = np.isfinite(current)
    filled = np.interp(time, time[known], current[known]) if known.any() else np.zeros(len(time))
    return Commands(recording.name, savgol_filter(stroke, SMOOTHING, polyorder=2), filled)


def dissipated_W(force_N: F, speed_m_s: F) -> F:
    """Return the power [W] that heats the damper, never negative: what springs give back heats nothing."""
    return np.maximum(force_N * speed_m_s, 0.0)


def recorded_power(recording: Recording) -> F:
    """Return the dissipated power [W] on the grid of the commands, (n,)."""
    commands, force = recorded_commands(recording), recording.channel("force")
    start = int(recording.channel("position").stamps_ns.min())
    at = (force.stamps_ns - start) * 1e-9
    good = np.isfinite(force.values)
    return dissipated_W(np.interp(commands.time_s, at[good], force.values[good]), commands.motion()[0])
