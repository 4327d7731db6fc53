"""Filters to compare with the bank: positions at a uniform rate and one setting go in, speeds come out.

A speed belongs to its sample; with a delay [samples] it may use so many later ones. Linear filters are IIR or FIR, the
others are loops.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import factorial

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import lfilter, savgol_coeffs, ss2tf

F = NDArray[np.float64]
Filter = Callable[[F, float, float], F]  # positions [m], rate [Hz], the setting -> speeds [m/s]
LONGEST = 60  # [samples] window


@dataclass(frozen=True)
class Peer:
    """A filter and the values of its setting at 1 kHz to try."""

    name: str
    speeds: Filter
    unit: str
    grid: tuple[float, ...]


def observer(order: int, butterworth: bool = True) -> Filter:
    """Chain of `order` integrators, corrected by the position with gains that place its poles at a bandwidth [Hz].

    Butterworth poles are those of the stationary Kalman filter for a chain that white noise drives; equal poles are
    those of a high-gain observer.
    """
    k = np.arange(order)
    places = np.exp(1j * np.pi * (2 * k + order + 1) / (2 * order)) if butterworth else np.full(order, -1.0)

    def speeds(x: F, rate: float, bandwidth: float) -> F:
        step = 1.0 / rate
        advance = np.array([[step ** (j - i) / factorial(max(j - i, 0)) * (j >= i) for j in k] for i in k])
        gain = _place(advance, advance[:1], np.exp(2.0 * np.pi * bandwidth * step * places))
        closed = advance - np.outer(gain, advance[0])
        b, a = ss2tf(closed, (closed @ gain)[:, None], np.eye(order)[1:2], np.array([[gain[1]]]))
        return np.asarray(lfilter(b[0], a, x - x[0]))

    return speeds


def savitzky_golay(degree: int, delay: int = 0) -> Filter:
    """Slope of the least-squares polynomial over the last rate / bandwidth samples, `delay` before the newest."""

    def speeds(x: F, rate: float, bandwidth: float) -> F:
        window = max(degree + 1, delay + 1, round(rate / bandwidth))
        b = savgol_coeffs(window, degree, deriv=1, delta=1.0 / rate, pos=window - 1 - delay, use="dot")
        now = lfilter(b[::-1], np.ones(1), x - x[0])
        return np.append(now[delay:], np.full(delay, now[-1]))

    return speeds


@njit(cache=True)
def super_twisting(x: F, rate: float, bound: float) -> F:
    """First-order robust exact differentiator (Levant 1998); `bound` [m/s2] is that of the acceleration."""
    out, step = np.zeros(len(x)), 1.0 / rate
    z0, z1 = x[0], 0.0
    for k in range(len(x)):
        error = z0 - x[k]
        out[k] = z1
        z0 += step * (z1 - 1.5 * np.sqrt(bound * abs(error)) * np.sign(error))
        z1 -= step * 1.1 * bound * np.sign(error)
    return out


@njit(cache=True)
def adaptive_window(x: F, rate: float, bound: float) -> F:
    """First-order adaptive windowing (Janabi-Sharifi, Hayward & Chen 2000), best fit over the longest window."""
    out = np.zeros(len(x))
    for k in range(1, len(x)):
        for n in range(1, min(LONGEST, k) + 1):
            slope = 0.0
            for i in range(n + 1):
                slope += (n - 2.0 * i) * x[k - i]
            slope *= 6.0 / (n * (n + 1.0) * (n + 2.0))  # least squares over the last n + 1 samples
            fits = True
            for i in range(1, n):
                fits &= abs(x[k - i] - (x[k] - slope * i)) <= bound
            if not fits:
                break
            out[k] = slope * rate
    return out


def _place(advance: F, see: F, poles: NDArray[np.complex128]) -> F:
    """Ackermann's gain: `advance` - gain `see` has the given `poles`."""
    n = len(advance)
    observability = np.vstack([see @ np.linalg.matrix_power(advance, i) for i in range(n)])
    polynomial = sum(c * np.linalg.matrix_power(advance, n - i) for i, c in enumerate(np.real(np.poly(poles))))
    return np.asarray(polynomial @ np.linalg.solve(observability, np.eye(n)[:, -1]))


def grid(low: float, high: float, count: int = 12) -> tuple[float, ...]:
    """Return values in equal ratios."""
    return tuple(np.geomspace(low, high, count).tolist())


PEERS = (
    Peer("Kalman, white jerk", observer(3), "Hz", grid(40, 250)),
    Peer("high-gain observer, third order", observer(3, butterworth=False), "Hz", grid(20, 200)),
    Peer("Savitzky–Golay 2, end", savitzky_golay(2), "Hz", grid(40, 250)),
    Peer("super-twisting", super_twisting, "m/s²", grid(10, 1000)),
    Peer("adaptive window (FOAW)", adaptive_window, "m", grid(1e-6, 3e-4)),
    Peer("Savitzky–Golay 3, 3 ms later", savitzky_golay(3, 3), "Hz", grid(20, 150)),
)
