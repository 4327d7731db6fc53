"""The state of a damper as a design sees it, and smooth random features of that state.

The state is what decides the force: stroke, speed, current, and the recent past as the distance of speed and current
from their own low-passes (the same five that the band of a model uses). A Gaussian process over that state stands for
any model: its posterior variance says where the force is still unknown, whatever structure is fitted later. Its kernel
is approximated by random Fourier features (Rahimi and Recht, NIPS 2007), so that what many experiments have shown is
one matrix of fixed size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from ces_iterate.commands import INTERVAL_S
from ces_iterate.plan.limits import RigLimits

F = NDArray[np.float64]

STATE = ("stroke", "speed", "current", "change of speed", "change of current")
SCALES = np.array([1.2, 0.45, 0.7, 0.6, 0.9])  # of the kernel, in units of the scaled state
KNEE = 0.08  # share of the largest speed at which a damper's force typically bends
PAST_S = 0.02  # time constant of the low-passes
COUNT = 240  # features


def scaled_state(stroke_m: F, speed_m_s: F, current_A: F, limits: RigLimits, interval_s: float = INTERVAL_S) -> F:
    """Return the state (n, 5), each component about -1 to 1 within the limits; speeds are stretched around zero."""
    half = max(0.5 * (limits.high_A - limits.low_A), 1e-9)
    current = (current_A - 0.5 * (limits.high_A + limits.low_A)) / half
    speed = stretch(speed_m_s / limits.speed_m_s)
    changes = [2.0 * _change(signal, interval_s) for signal in (speed, current)]
    return np.column_stack([(stroke_m - limits.centre_m) / limits.stroke_m, speed, current, *changes])


def stretch(share: F) -> F:
    """Return a speed, as a share of the largest, on a scale that is linear below `KNEE` and logarithmic above."""
    return np.asarray(np.arcsinh(share / KNEE) / np.arcsinh(1.0 / KNEE))


def _change(signal: F, interval_s: float) -> F:
    decay = np.exp(-interval_s / PAST_S)
    return np.asarray(signal - lfilter([1.0 - decay], [1.0, -decay], signal, zi=[decay * signal[0]])[0])


@dataclass(frozen=True)
class Features:
    """Random Fourier features of a Gaussian kernel of unit variance: `frequencies` (5, COUNT), `phases` (COUNT,)."""

    frequencies: F
    phases: F

    def at(self, state: F) -> F:
        """Return the features (n, COUNT) at states (n, 5)."""
        return np.asarray(np.sqrt(2.0 / len(self.phases)) * np.cos(state @ self.frequencies + self.phases))


def draw_features(seed: int) -> Features:
    """Return the features that belong to a seed."""
    rng = np.random.default_rng([seed, 11])
    return Features(rng.standard_normal((len(STATE), COUNT)) / SCALES[:, None], rng.uniform(0.0, 2.0 * np.pi, COUNT))
