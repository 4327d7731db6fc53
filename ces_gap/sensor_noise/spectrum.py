"""Noise from single samples of the force channel: the highest frequencies, and the step of the logged values.

A damper has little force near the Nyquist frequency, and mostly in bursts (reversals, opening valves), so a flat top
of the spectrum in the quieter parts of the recording is white noise: an upper bound, as the damper may contribute. If
the spectrum still falls at the top, or ends at the noise of the quantisation, the sensor or the logger may have
filtered the force: the noise at lower frequencies may then be larger by any factor.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.signal import spectrogram

from ces_gap.sensor_noise.noise_estimate import HIGH_FREQUENCIES, F, NoiseEstimate

SEGMENT = 64  # samples of a spectrum
QUIET = 0.1  # share of the spectra that count as quiet
TOP = (7 / 8, 1.0)  # of the Nyquist frequency
BELOW_TOP = ((3 / 4, 7 / 8), (5 / 8, 3 / 4), (1 / 2, 5 / 8))
MAX_FALL = (1.25, 1.3, 1.5)  # power in the bands below the top, over that at the top, of a flat spectrum
MIN_OVER_QUANTUM = 1.5  # power at the top over that of the quantisation, if the noise is not filtered
MIN_SAMPLES = 200
WHITE_SAMPLES = 200_000  # of white noise of 1 N, which calibrates the levels
MAX_STEPS = 1e6  # of the quantum in the largest difference; finer steps are rounding of the file's numbers


def find_quantum_N(values: F) -> float:
    """Return the step [N] of which all differences of logged values (n,) are multiples, 0 if there is none."""
    differences = np.abs(np.diff(values))
    largest = float(differences.max(initial=0.0))
    steps = np.unique(np.round(differences[differences > largest / MAX_STEPS] / max(largest, 1e-300), 9)) * largest
    if not len(steps) or len(steps) > len(values) / 2:
        return 0.0
    step = _refine_step(differences, float(steps[0]))
    off = np.abs(differences / step - np.round(differences / step))
    return step if float(np.quantile(off, 0.9)) < 0.05 else 0.0


def _refine_step(differences: F, step: float) -> float:
    """Return the step near `step` that fits ever larger differences; the file's numbers may be rounded."""
    for reach in (5.0, 20.0, 100.0, 1000.0):
        near = differences[differences < reach * step]
        counts = np.round(near / step)
        step = float(counts @ near / max(float(counts @ counts), 1e-300)) or step
    return step


def estimate_from_spectrum(values: F, quantum_N: float, on_grid: float) -> NoiseEstimate:
    """Return white noise as strong as the top eighth of the spectrum of samples `values` [N] (n,).

    White noise of 1 N at the samples is `on_grid` [N] on the grid.
    """
    if len(values) < MIN_SAMPLES:
        return NoiseEstimate(HIGH_FREQUENCIES, 0.0, f"{len(values)} samples")
    top, *below = _quiet_levels(values) / _quiet_levels_of_white_noise()
    problem = ""
    if top < MIN_OVER_QUANTUM * quantum_N**2 / 12.0:
        problem = "the spectrum ends at the noise of the quantisation"
    elif any(level > fall * top for level, fall in zip(below, MAX_FALL, strict=True)):
        problem = "the spectrum still falls at its top"
    return NoiseEstimate(HIGH_FREQUENCIES, float(np.sqrt(top)) * on_grid, problem)


@cache
def _quiet_levels_of_white_noise() -> F:
    return _quiet_levels(np.random.default_rng(1).standard_normal(WHITE_SAMPLES))


def _quiet_levels(values: F) -> F:
    """Return the power of the quiet parts at the top of the spectrum and in the bands below it."""
    frequency, _, power = spectrogram(values, 2.0, "hann", SEGMENT, SEGMENT // 2)
    bands = [power[(frequency >= low) & (frequency < high)].mean(0) for low, high in (TOP, *BELOW_TOP)]
    return np.asarray([np.quantile(band, QUIET) for band in bands])
