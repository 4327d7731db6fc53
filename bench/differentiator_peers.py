"""Causal differentiators to compare: each takes positions at a uniform rate and one setting, and returns speeds.

The number is a bandwidth [Hz], except for Levant's (bound on the jerk [m/s3]) and the adaptive window (noise bound
[m]). Linear ones are IIR or FIR filters; the two nonlinear ones are loops.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import factorial

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import butter, lfilter, savgol_coeffs, ss2tf

F = NDArray[np.float64]
Filter = Callable[[F, float, float], F]  # positions [m], rate [Hz], the setting -> speeds [m/s]


@dataclass(frozen=True)
class Peer:
    """A differentiator, and the values of its setting at 1 kHz to try."""

    name: str
    speeds: Filter
    unit: str
    grid: tuple[float, ...]


def kalman(order: int) -> Filter:
    """Steady-state Kalman filter of a chain of `order` integrators driven by white noise (Butterworth poles)."""

    def speeds(x: F, rate: float, bandwidth: float) -> F:
        step = 1.0 / rate
        k = np.arange(order)
        poles = np.exp(2.0 * np.pi * bandwidth * step * np.exp(1j * np.pi * (2 * k + order + 1) / (2 * order)))
        advance = np.array([[step ** (j - i) / factorial(max(j - i, 0)) * (j >= i) for j in k] for i in k])
        gain = _place(advance, advance[:1], poles)
        closed = advance - np.outer(gain, advance[0])
        select = np.eye(order)[1:2]
        b, a = ss2tf(closed, (closed @ gain)[:, None], select, np.array([[gain[1]]]))
        return _filter(b[0], a, x)

    return speeds


def difference(order: int) -> Filter:
    """Backward difference through a Butterworth low-pass."""

    def speeds(x: F, rate: float, bandwidth: float) -> F:
        b, a = butter(order, min(bandwidth, 0.49 * rate), fs=rate)
        return _filter(np.convolve(b, [rate, -rate]), a, x)

    return speeds


def savitzky_golay(degree: int) -> Filter:
    """Slope of the least-squares polynomial over the last rate / bandwidth samples, at the newest."""

    def speeds(x: F, rate: float, bandwidth: float) -> F:
        window = max(degree + 1, round(rate / bandwidth))
        b = savgol_coeffs(window, degree, deriv=1, delta=1.0 / rate, pos=window - 1, use="dot")
        return _filter(b[::-1], np.ones(1), x)

    return speeds


def levant(x: F, rate: float, bound: float) -> F:
    """Levant's robust exact differentiator of second order in homogeneous discrete form (Livne & Levant 2014)."""
    return _levant(x, 1.0 / rate, bound)


def adaptive_window(x: F, rate: float, bound: float) -> F:
    """First-order adaptive windowing (Janabi-Sharifi, Hayward & Chen 2000), best fit over the longest window."""
    return _adaptive_window(x, 1.0 / rate, bound, 60)


@njit(cache=True)
def _levant(x: F, step: float, bound: float) -> F:
    out = np.zeros(len(x))
    z0, z1, z2 = x[0], 0.0, 0.0
    for k in range(len(x)):
        error = z0 - x[k]
        size, sign = abs(error), np.sign(error)
        rate0 = z1 - 2.0 * (bound * size * size) ** (1.0 / 3.0) * sign
        rate1 = z2 - 2.12 * (bound * bound * size) ** (1.0 / 3.0) * sign
        out[k] = z1
        z0 += step * rate0 + 0.5 * step * step * z2
        z1 += step * rate1
        z2 -= step * 1.1 * bound * sign
    return out


@njit(cache=True)
def _adaptive_window(x: F, step: float, bound: float, longest: int) -> F:
    out = np.zeros(len(x))
    for k in range(1, len(x)):
        for n in range(1, min(longest, k) + 1):
            slope = 0.0
            for i in range(n + 1):
                slope += (n - 2.0 * i) * x[k - i]
            slope *= 6.0 / (n * (n + 1.0) * (n + 2.0))  # least squares over the last n + 1 samples
            fits = True
            for i in range(1, n):
                fits &= abs(x[k - i] - (x[k] - slope * i)) <= bound
            if not fits:
                break
            out[k] = slope / step
    return out


def _place(advance: NDArray[np.float64], see: NDArray[np.float64], poles: NDArray[np.complex128]) -> F:
    """Ackermann's gain: `advance` - gain `see` has the given `poles`."""
    n = len(advance)
    observability = np.vstack([see @ np.linalg.matrix_power(advance, i) for i in range(n)])
    polynomial = sum(c * np.linalg.matrix_power(advance, n - i) for i, c in enumerate(np.real(np.poly(poles))))
    return np.asarray(polynomial @ np.linalg.solve(observability, np.eye(n)[:, -1]))


def _filter(b: F, a: F, x: F) -> F:
    return np.asarray(lfilter(b, a, x - x[0]))


def _grid(low: float, high: float, count: int = 25) -> tuple[float, ...]:
    return tuple(np.geomspace(low, high, count).tolist())


PEERS = (
    Peer("Kalman, white acceleration (α-β)", kalman(2), "Hz", _grid(50, 330)),
    Peer("Kalman, white jerk", kalman(3), "Hz", _grid(40, 330)),
    Peer("Kalman, white snap", kalman(4), "Hz", _grid(30, 250)),
    Peer("difference, 1 pole", difference(1), "Hz", _grid(50, 450)),
    Peer("difference, Butterworth 2", difference(2), "Hz", _grid(50, 450)),
    Peer("Savitzky–Golay 1, end", savitzky_golay(1), "Hz", _grid(40, 500)),
    Peer("Savitzky–Golay 2, end", savitzky_golay(2), "Hz", _grid(40, 330)),
    Peer("Savitzky–Golay 3, end", savitzky_golay(3), "Hz", _grid(30, 250)),
    Peer("Levant, second order", levant, "m/s³", _grid(1e3, 1e6)),
    Peer("adaptive window (FOAW)", adaptive_window, "m", _grid(1e-6, 3e-4)),
)
