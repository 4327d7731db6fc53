"""The noise of a measured force on the grid of its trace, from independent sources; the smallest bound counts."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ces_gap.sensor_noise.cycles import correlate_neighbours, estimate_from_cycles
from ces_gap.sensor_noise.noise_estimate import (
    HIGH_FREQUENCIES,
    QUANTUM,
    UNMEASURED,
    F,
    GridSignals,
    MeasuredNoise,
    NoiseEstimate,
)
from ces_gap.sensor_noise.spectrum import estimate_from_spectrum, find_quantum_N
from ces_gap.sensor_noise.standstill import estimate_from_standstill

MAX_COLOUR = 0.1  # autocorrelation from tick to tick, above that of white noise, of noise that counts as white


def measure_noise(samples: F, resample: Callable[[F], F], signals: GridSignals) -> MeasuredNoise:
    """Return the noise of the force on the grid.

    `samples` [N] (m,) are the logged forces; `resample` returns m values on the grid (n,).
    """
    values = samples[np.isfinite(samples)]
    if not signals.usable.any() or not len(values) or np.ptp(values) == 0.0:
        return UNMEASURED
    white = resample(np.random.default_rng(0).standard_normal(len(samples)))  # resampling attenuates noise
    on_grid, white_lag1 = float(white.std()), correlate_neighbours(white, np.ones(len(white), bool))
    quantum = find_quantum_N(values)
    floor = NoiseEstimate(QUANTUM, quantum / math.sqrt(12.0) * on_grid, "a lower bound")
    repeated = [estimate_from_cycles(signals), estimate_from_standstill(signals)]
    high = _check_colour(estimate_from_spectrum(values, quantum, on_grid), repeated, white_lag1)
    return _combine([*repeated, high], floor, quantum, white_lag1)


def _check_colour(high: NoiseEstimate, repeated: list[NoiseEstimate], white_lag1: float) -> NoiseEstimate:
    """Return the estimate from high frequencies, not valid if another source shows that the noise is not white."""
    coloured = next((e for e in repeated if e.valid and e.lag1 > white_lag1 + MAX_COLOUR), None)
    if coloured is None or not high.valid:
        return high
    return NoiseEstimate(HIGH_FREQUENCIES, high.rms_N, f"the noise at {coloured.source} is not white")


def _combine(
    estimates: list[NoiseEstimate], floor: NoiseEstimate, quantum_N: float, white_lag1: float
) -> MeasuredNoise:
    """Return the smallest valid upper bound, or the largest lower bound if there is none; at least the `floor`."""
    valid = [e for e in estimates if e.valid]
    best = min(valid, key=lambda e: e.rms_N) if valid else max([*estimates, floor], key=lambda e: e.rms_N)
    if best.rms_N < floor.rms_N:
        best = floor
    others = tuple(e for e in (*estimates, floor) if e is not best)
    lag1 = next((e.lag1 for e in (best, *valid) if math.isfinite(e.lag1)), math.nan)
    return MeasuredNoise(best.rms_N, best.source, others, bool(valid), quantum_N, lag1, white_lag1)
