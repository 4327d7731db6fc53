"""Compiled loops of the effects with a state: plain loops over arrays on a trace's grid, one step a tick."""

from __future__ import annotations

from math import exp

import numpy as np
from numba import njit
from numpy.typing import NDArray

F = NDArray[np.float64]


@njit(cache=True, nogil=True, error_model="numpy")
def lagged_by_side(u: F, rise_s: float, fall_s: float, step_s: float) -> F:
    """Return u (n,) behind a first-order lag of `rise_s` where it grows and `fall_s` where it falls."""
    out = np.empty_like(u)
    z = u[0]
    out[0] = z
    for k in range(1, len(u)):
        z = _lag_step(z, u[k - 1], u[k], rise_s if u[k] > z else fall_s, step_s)
        out[k] = z
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _lag_step(z: float, before: float, now: float, time_s: float, step_s: float) -> float:
    """Return the lag's next state, its input running straight from `before` to `now` (first-order hold)."""
    ratio = time_s / step_s
    if ratio < 1e-9:
        return now
    pole = exp(-1.0 / ratio)
    ramp = ratio * (1.0 - pole)
    return pole * z + (ramp - pole) * before + (1.0 - ramp) * now


@njit(cache=True, nogil=True, error_model="numpy")
def gated_play(x: F, openness: F, gap: float) -> F:
    """Return where (n,) in its free play a joint is, in [-gap/2, gap/2], begun at the middle.

    It is carried along by x; `openness` (n,) in [0, 1] is how far the force lets it move towards +gap/2 (1: pushed, in
    compression) and 1 - openness how far towards -gap/2.
    """
    out = np.empty_like(x)
    half = 0.5 * gap
    z = 0.0
    out[0] = z
    for k in range(1, len(x)):
        step = x[k] - x[k - 1]
        share = openness[k] if step > 0.0 else 1.0 - openness[k]
        z = min(max(z + share * step, -half), half)
        out[k] = z
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def mean_of_plays(u: F, widest: float, count: int) -> F:
    """Return the mean of `count` play operators of u (n,), half-widths evenly up to `widest`, begun at rest."""
    out = u.copy()
    for j in range(1, count + 1):
        radius = widest * j / count
        z = u[0]
        for k in range(len(u)):
            z = min(max(z, u[k] - radius), u[k] + radius)
            out[k] += (z - u[k]) / count
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def coleman_hodgdon(u: F, height: float, travel: float) -> F:
    """Return h (n,) of dh/du = -(height + h)/travel for rising u and (height - h)/travel for falling, begun at 0."""
    out = np.empty_like(u)
    h = 0.0
    out[0] = h
    for k in range(1, len(u)):
        step = u[k] - u[k - 1]
        target = -height if step > 0.0 else height
        h = target + (h - target) * exp(-abs(step) / travel)
        out[k] = h
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def void(rate: F, step_s: float) -> F:
    """Return the length [m] (n,) of a void that opens at `rate` [m/s] (n,) and is never less than nothing."""
    out = np.empty_like(rate)
    z = 0.0
    out[0] = z
    for k in range(1, len(rate)):
        z = max(z + 0.5 * (rate[k - 1] + rate[k]) * step_s, 0.0)
        out[k] = z
    return out
