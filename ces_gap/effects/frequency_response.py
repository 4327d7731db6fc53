"""Filtering a force by a frequency response, without the wrap-around of the Fourier transform."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from ces_gap.trace import F

RUN_OUT_S = 0.25  # [s] of padding that leads from the last value back to the first


def apply_response(force: F, rate_Hz: float, response: Callable[[F], NDArray[np.complex128]]) -> F:
    """Return the force (n,) behind `response`, a function of the angular frequencies [rad/s]."""
    count = len(force)
    padded = next_fast_len(count + round(RUN_OUT_S * rate_Hz), real=True)
    bridge = np.linspace(force[-1], force[0], padded - count + 2)[1:-1]
    frequency = 2.0 * np.pi * rate_Hz * np.arange(padded // 2 + 1) / padded
    spectrum = rfft(np.concatenate([force, bridge])) * response(frequency)
    return np.asarray(irfft(spectrum, padded)[:count])
