"""A synthetic semi-active damper for comparing identification tools: three independent 30 s recordings at 1 kHz.

Valve lag 8 ms, force ~ |v|^0.62 with current-dependent gain, Coulomb friction, gas spring, 5 ms force lag, 8 N of noise
(noise floor J = 1.5). Usage: `current, speed, force = make(seed)`; seeds 1, 2, 3 are estimation, selection and test.
`series(seed)` is the same as `ces_identify` reads it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, lfilter, sosfiltfilt

from ces_identify.polynomial.problem import Problem
from ces_identify.polynomial.search_limits import SearchResult
from ces_identify.prepare.series import Series
from ces_observer.model import Model, Sampling
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.terms import Term

F = NDArray[np.float64]

RATE = 1000.0
OVERSAMPLING = 10
SAMPLING = Sampling(RATE, 15e-6, 0.3, (-0.1, 0.1), 0.01)  # the speed is an input: no bank estimates it
WARM_UP = 100  # ticks excluded from every evaluation


def make(seed: int, seconds: float = 30.0) -> tuple[F, F, F]:
    """Current [A], speed [m/s] and measured force [N], each of shape (seconds * RATE,)."""
    rng = np.random.default_rng(seed)
    fine = RATE * OVERSAMPLING
    n = int((seconds + 2) * fine)

    def low_pass(cutoff: float) -> F:
        white = rng.standard_normal(int((seconds + 2) * RATE))
        w = sosfiltfilt(butter(4, cutoff, fs=RATE, output="sos"), white)
        return np.asarray(np.interp(np.arange(n) / fine, np.arange(len(w)) / RATE, w / w.std()))

    def lag(u: F, tau: float) -> F:
        a = np.exp(-1.0 / (fine * tau))
        return np.asarray(lfilter([1 - a], [1, -a], u))

    stroke = 0.018 * low_pass(4.0)
    speed = sosfiltfilt(butter(2, 100, fs=fine, output="sos"), np.gradient(stroke) * fine)
    current = np.clip(0.495 + 0.12 * low_pass(3.0), 0.29, 0.70)
    opening = (0.70 - (lag(current - 0.495, 0.008) + 0.495)) / 0.41
    gain = np.where(speed > 0, 900 + 1900 * (1 - opening) ** 1.3, 500 + 900 * (1 - opening) ** 1.2)
    gas = 10e5 * 1.5e-4 * (1.0e-4 / (1.0e-4 - 1.5e-4 * np.clip(stroke, -0.1, 0.1))) ** 1.3
    force = lag(gain * np.sign(speed) * np.abs(speed) ** 0.62 + 45 * np.tanh(speed / 0.008) + gas, 0.005)
    keep = slice(int(fine), int(fine) + int(seconds * fine), OVERSAMPLING)
    noise = 8.0 * rng.standard_normal(int(seconds * RATE))
    return current[keep].copy(), speed[keep].copy(), force[keep] + noise


def position_of(speed: F) -> F:
    """Return the position [m] by cumulative trapezoids, about its mean."""
    steps = np.diff(speed, prepend=speed[0])
    x = np.cumsum(speed - 0.5 * steps) / RATE
    return np.asarray(x - x.mean())


def series(seed: int, seconds: float = 30.0) -> Series:
    """Return a recording as prepared ticks: with the true speed."""
    current, speed, force = make(seed, seconds)
    ticks = np.arange(len(speed))
    return Series(
        name=f"damper_set {seed}",
        rate_Hz=RATE,
        time_s=ticks / RATE,
        position=position_of(speed),
        speed=speed,
        current=current,
        force=force,
        segments=np.array([[0, len(speed)]], np.int64),
        scored=ticks >= WARM_UP,
        warm_up=WARM_UP,
        dropped={},
    )


def model_of(problem: Problem, result: SearchResult) -> Model:
    """Return the polynomial that a search on this damper has found."""
    terms = [
        Term(float(c), problem.candidates[i].factors) for c, i in zip(result.coefficients, result.chosen, strict=True)
    ]
    return Model(SAMPLING, Polynomial(tuple(terms)), problem.envelope, problem.force_envelope)
