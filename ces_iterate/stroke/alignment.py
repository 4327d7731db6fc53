"""The position of a recording on the grid of its command: stamped samples go in, uniform ones come out.

Time 0 is the start of the command. A channel `command` (the stroke as commanded, on the recording's clock) shows when
that was. Without one the position itself is laid over the command: the actuator's mean delay is then taken out of every
run alike, and the piston makes the wanted stroke as much later.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ces_identify.recordings.recording import Channel, Recording
from ces_iterate.stroke.errors import StrokeError

Array = NDArray[np.float64]

COMMAND, POSITION = "command", "position"
MAX_GAP_S = 0.02  # [s] between position samples; longer ones would be bridged by a guess
MAX_MISSING_S = 0.1  # [s] at either end of the command
REFINEMENTS = 5


def position_on_grid(recording: Recording, command_m: Array, interval_s: float) -> Array:
    """Return the measured position [m] at the times of `command_m` (n,); raises StrokeError for missing samples."""
    if POSITION not in recording.channels:
        raise StrokeError(f"{recording.name}: no position in the recording; expected the piston's position")
    start = _find_start(recording, command_m, interval_s)
    time, values = _samples(recording.channel(POSITION), start)
    length = (len(command_m) - 1) * interval_s
    _require_complete(recording.name, time, length)
    grid = np.arange(len(command_m), dtype=np.float64) * interval_s
    return np.asarray(CubicSpline(time, values)(np.clip(grid, time[0], time[-1])))


def _samples(channel: Channel, start_ns: float) -> tuple[Array, Array]:
    """Return finite samples in order of rising times [s] since the start."""
    good = np.isfinite(channel.values)
    stamps, first = np.unique(channel.stamps_ns[good], return_index=True)
    origin = int(stamps[0]) if len(stamps) else 0
    time = ((stamps - origin).astype(np.float64) + (origin - start_ns)) * 1e-9
    return time, channel.values[good][first]


def _require_complete(name: str, time: Array, length: float) -> None:
    if len(time) < 10 or time[0] > MAX_MISSING_S or time[-1] < length - MAX_MISSING_S:
        span = f"{time[0]:.2f} to {time[-1]:.2f} s" if len(time) else "no samples"
        raise StrokeError(f"{name}: positions cover {span} of the command; expected 0 to {length:.2f} s")
    inside = (time[1:] > 0.0) & (time[:-1] < length)
    gap = float(np.diff(time)[inside].max())
    if gap > MAX_GAP_S:
        raise StrokeError(f"{name}: {1e3 * gap:.0f} ms without a position; expected at most {1e3 * MAX_GAP_S:.0f} ms")


def _find_start(recording: Recording, command_m: Array, interval_s: float) -> float:
    """Return the stamp [ns] at which the command began."""
    channel = recording.channel(COMMAND if COMMAND in recording.channels else POSITION)
    if not np.isfinite(channel.values).any():
        return 0.0
    first = float(channel.stamps_ns[0])
    time, values = _samples(channel, first)
    grid = np.arange(time[0], time[-1], interval_s)
    shift = _coarse_shift(np.interp(grid, time, values), command_m) * interval_s
    spline = CubicSpline(np.arange(len(command_m)) * interval_s, command_m)
    inside = (time > shift + 0.1) & (time < shift + (len(command_m) - 1) * interval_s - 0.1)
    for _ in range(REFINEMENTS):  # Gauss-Newton on the delay
        slope = spline(time[inside] - shift, 1)
        error = values[inside] - spline(time[inside] - shift)
        power = float(slope @ slope)
        shift -= float(slope @ error) / power if power > 0.0 else 0.0
    return first + 1e9 * shift


def _coarse_shift(logged: Array, command: Array) -> int:
    """Return how many samples after the log's first one the command begins."""
    size = len(logged) + len(command)
    spectra = np.fft.rfft(logged - logged.mean(), size), np.fft.rfft(command - command.mean(), size)
    correlation = np.fft.irfft(spectra[0] * spectra[1].conj(), size)
    lag = int(np.argmax(correlation))
    return lag if lag < len(logged) else lag - size
