"""The uniform grid of a trace: its rate, and how channels are bridged, smoothed and thinned onto it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, firwin, sosfiltfilt, welch

from ces_gap.errors import GapError
from ces_identify.recordings.recording import Recording

F = NDArray[np.float64]
B = NDArray[np.bool_]

GRID_HZ = 500.0  # [Hz] highest rate of the grid: an effect of a damper shows far below half of it
MAX_SILENCE_S = 0.05  # [s] longer silence of a channel is not bridged
SMOOTHING_HZ = (15.0, 70.0)  # [Hz] range of the position's low-pass
ABOVE_NOISE = 10.0  # power of the position over its noise floor up to where it is kept


def find_rates(seconds: F, name: str) -> tuple[float, int]:
    """Return the rate of the position samples [Hz] and by how much the grid is coarser."""
    steps = np.diff(seconds)
    steps = steps[steps > 0.0]
    if len(steps) < 100:
        raise GapError(f"{name}: {len(steps) + 1} position samples; expected at least 100")
    rate = 1.0 / float(np.median(steps))
    rate = round(rate) if abs(rate - round(rate)) < 0.02 * rate else rate
    return float(rate), max(1, round(rate / GRID_HZ - 0.25))


def base_times(seconds: F, rate_Hz: float) -> F:
    """Return the ticks [s] of a grid at the rate of the position samples, which are at `seconds` (p,)."""
    return np.arange(int(seconds[-1] * rate_Hz + 1e-6) + 1) / rate_Hz


def bridge_gaps(seconds: F, values: F, grid: F) -> tuple[F, B]:
    """Return the values on the grid, gaps bridged, and where (n,) they are known."""
    good = np.isfinite(values)
    if good.sum() < 2:
        return np.zeros_like(grid), np.zeros(len(grid), bool)
    at, first = np.unique(seconds[good], return_index=True)
    after = np.clip(np.searchsorted(at, grid), 1, len(at) - 1)
    known = (grid >= at[0]) & (grid <= at[-1]) & (np.diff(at)[after - 1] <= MAX_SILENCE_S)
    return np.interp(grid, at, values[good][first]), known


def find_low_pass_Hz(position: F, rate_Hz: float) -> float:
    """Return up to where the position stands out of its noise [Hz]."""
    frequency, power = welch(position, rate_Hz, nperseg=min(len(position), 2048))
    floor = float(np.median(power[3 * len(power) // 4 :]))
    signal = np.flatnonzero(power > ABOVE_NOISE * floor)
    top = float(frequency[signal[-1]]) if len(signal) else SMOOTHING_HZ[1]
    return float(np.clip(1.5 * top, SMOOTHING_HZ[0], min(SMOOTHING_HZ[1], 0.4 * rate_Hz)))


def smooth_out(position: F, low_pass_Hz: float, rate_Hz: float) -> F:
    """Return the position (n,) without what is above `low_pass_Hz`, not delayed."""
    sos = butter(4, low_pass_Hz, fs=rate_Hz, output="sos")
    return np.asarray(sosfiltfilt(sos, position, padlen=min(len(position) - 1, round(0.2 * rate_Hz))))


def thin_out(values: F, factor: int) -> F:
    """Return every `factor`-th value behind a symmetric low-pass at half the grid's rate."""
    if factor == 1:
        return values
    taps = _taps(factor)
    padded = np.pad(values, 4 * factor, mode="edge")
    return np.asarray(np.convolve(padded, taps, mode="valid")[::factor])


def _taps(factor: int) -> F:
    return np.asarray(firwin(8 * factor + 1, 0.8 / factor))


def estimate_noise_N(recording: Recording, clock: NDArray[np.int64], base: F, factor: int) -> float:
    """Return the RMS [N] on the grid of white noise as strong as the force logged in the top eighth of frequencies."""
    if "force" not in recording.channels:
        return 0.0
    channel = recording.channel("force")
    values = channel.values[np.isfinite(channel.values)]
    power = welch(values, 2.0, nperseg=min(len(values), 64), average="median")[1]
    level = float(np.median(power[7 * len(power) // 8 : -1]))
    drawn = np.random.default_rng(0).standard_normal(len(channel))  # what resampling leaves of it
    resampled = thin_out(bridge_gaps((channel.stamps_ns - clock[0]) * 1e-9, drawn, base)[0], factor)
    return float(np.sqrt(level) * resampled.std())


def without_edges(known: B, edge: int) -> B:
    """Return `known` without `edge` samples at either end of each stretch."""
    unknown = np.pad((~known).astype(np.float64), edge, constant_values=1.0)
    near: F = np.convolve(unknown, np.ones(2 * edge + 1), mode="valid")
    return np.asarray(near < 0.5)
