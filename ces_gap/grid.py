"""The uniform grid of a trace: its rate; channels interpolated, smoothed, decimated and differentiated on it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.signal import butter, firwin, sosfiltfilt, welch

from ces_data.arrays import F, I, Mask
from ces_gap.errors import GapError
from ces_gap.limits import DiagnosisLimits
from ces_identify.limits import TickLimits

GRID_HZ = 500.0  # [Hz] highest rate of the grid: the effects of a damper lie far below half of it
SMOOTHING_HZ = (15.0, 200.0)  # [Hz] range of the position's low-pass; a lower limit takes real motion from fast strokes
RUN_OUT_S = 0.25  # [s] of padding that leads from the last value of a response back to the first
ABOVE_NOISE = 10.0  # power of the position over its noise floor that counts as signal


def derivative(values: F, rate_Hz: float) -> F:
    """Return the derivative of uniform samples (n,), central differences of fourth order, lower at the ends."""
    out: F = np.gradient(values) * rate_Hz
    if len(values) > 4:
        out[2:-2] = (8.0 * (values[3:-1] - values[1:-3]) - (values[4:] - values[:-4])) * (rate_Hz / 12.0)
    return out


def apply_response(force: F, rate_Hz: float, response: Callable[[F], NDArray[np.complex128]]) -> F:
    """Return the force (n,) behind `response`, a function of the angular frequencies [rad/s]."""
    count = len(force)
    padded = next_fast_len(count + round(RUN_OUT_S * rate_Hz), real=True)
    bridge = np.linspace(force[-1], force[0], padded - count + 2)[1:-1]
    frequency = 2.0 * np.pi * rate_Hz * np.arange(padded // 2 + 1) / padded
    spectrum = rfft(np.concatenate([force, bridge])) * response(frequency)
    return np.asarray(irfft(spectrum, padded)[:count])


def number_blocks(times: Sequence[F], block_s: float) -> list[I]:
    """Return the number of the block of `block_s` seconds of each tick (n,), counted through all of the `times`."""
    return count_through([(time_s / block_s).astype(np.int64) for time_s in times])


def count_through(parts: Sequence[I]) -> list[I]:
    """Return the numbers (n,) of each part, rising from 0, counted on from one part to the next."""
    starts = np.cumsum([0, *(part[-1] + 1 for part in parts[:-1])])
    return [start + part for start, part in zip(starts, parts, strict=True)]


def rms(values: F) -> float:
    """Return the root of the mean square of `values`."""
    return float(np.sqrt(np.mean(values**2)))


def is_constant(current: F, least_A: float = 1e-9) -> bool:
    """Return whether a current [A] is constant but for noise; the spread counts relative to the mean or `least_A`."""
    return bool(current.std() <= DiagnosisLimits.CONSTANT * max(abs(float(current.mean())), least_A))


def lay_base_grid(seconds: F, name: str) -> tuple[F, float, int]:
    """Return the ticks [s] of an even grid over the position samples at `seconds` (p,), at their rate.

    The rate [Hz] and the factor by which the grid of a trace decimates it follow. Raises GapError.
    """
    steps = np.diff(seconds)
    steps = steps[steps > 0.0]
    least = DiagnosisLimits.MIN_POSITIONS
    if len(steps) < least:
        raise GapError(f"{name}: {len(steps) + 1} position samples; expected at least {least}; record longer")
    rate = 1.0 / float(np.median(steps))
    rate = float(round(rate) if abs(rate - round(rate)) < 0.02 * rate else rate)
    return np.arange(int(seconds[-1] * rate + 1e-6) + 1) / rate, rate, max(1, round(rate / GRID_HZ - 0.25))


def bridge_gaps(seconds: F, values: F, grid: F) -> tuple[F, Mask]:
    """Return the values (n,) interpolated on the grid, and a mask (n,) of the ticks at which they are known."""
    at, known_values = _known_samples(seconds, values)
    if len(at) < 2:
        return np.zeros_like(grid), np.zeros(len(grid), bool)
    after = np.clip(np.searchsorted(at, grid), 1, len(at) - 1)
    is_known = (grid >= at[0]) & (grid <= at[-1]) & (np.diff(at)[after - 1] <= TickLimits.MIN_GAP_S)
    return np.interp(grid, at, known_values), is_known


def interpolate(seconds: F, values: F, grid: F) -> F:
    """Return the values (n,) of `bridge_gaps` alone."""
    at, known_values = _known_samples(seconds, values)
    return np.asarray(np.interp(grid, at, known_values)) if len(at) > 1 else np.zeros_like(grid)


def _known_samples(seconds: F, values: F) -> tuple[F, F]:
    """Return the times of finite values in ascending order, each once, with the first of their values."""
    good = np.isfinite(values)
    seconds, values = seconds[good], values[good]
    if (np.diff(seconds) > 0.0).all():
        return seconds, values
    at, index = np.unique(seconds, return_index=True)
    return at, values[index]


def find_low_pass_Hz(position: F, rate_Hz: float) -> float:
    """Return the frequency [Hz] up to which the position exceeds its noise."""
    frequency, power = welch(position, rate_Hz, nperseg=min(len(position), 2048))
    floor = float(np.median(power[3 * len(power) // 4 :]))
    signal = np.flatnonzero(power > ABOVE_NOISE * floor)
    top = float(frequency[signal[-1]]) if len(signal) else SMOOTHING_HZ[1]
    return float(np.clip(1.5 * top, SMOOTHING_HZ[0], min(SMOOTHING_HZ[1], 0.4 * rate_Hz)))


def smooth_out(position: F, low_pass_Hz: float, rate_Hz: float) -> F:
    """Return the position (n,) behind a low-pass at `low_pass_Hz` without delay."""
    sos = butter(4, low_pass_Hz, fs=rate_Hz, output="sos")
    return np.asarray(sosfiltfilt(sos, position, padlen=min(len(position) - 1, round(0.2 * rate_Hz))))


def thin_out(values: F, factor: int) -> F:
    """Return every `factor`-th value after a symmetric low-pass at half the rate of the grid."""
    if factor == 1:
        return values
    padded = np.pad(values, 4 * factor, mode="edge")
    return np.asarray(np.convolve(padded, _design_low_pass(factor), mode="valid")[::factor])


@cache
def _design_low_pass(factor: int) -> F:
    """Return the taps (8·factor + 1,) of a symmetric low-pass at half the rate that is left after decimation."""
    return np.asarray(firwin(8 * factor + 1, 0.8 / factor))


def without_edges(known: Mask, edge: int) -> Mask:
    """Return `known` without `edge` samples at either end of each segment."""
    unknown = np.pad((~known).astype(np.float64), edge, constant_values=1.0)
    near: F = np.convolve(unknown, np.ones(2 * edge + 1), mode="valid")
    return np.asarray(near < 0.5)
