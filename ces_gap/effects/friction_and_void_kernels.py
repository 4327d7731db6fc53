"""Compiled loops of effects on the force: friction with presliding, and voids. Slow versions are in the tests."""

from __future__ import annotations

from math import exp

import numpy as np
from numba import njit
from numpy.typing import NDArray

F = NDArray[np.float64]


@njit(cache=True, nogil=True)
def bristles(position: F, level: F, presliding: float) -> F:
    """Return the friction z (n,) of initially unbent bristles relative to sliding friction.

    dz/dx = (1 - z sign(dx) / level) / presliding, integrated exactly over each tick with its `level` (n,): the
    bristles tend to ±level over `presliding` * level of stroke [m] (Dahl 1968; Canudas de Wit et al. 1995).
    """
    out = np.zeros(len(position))
    z = 0.0
    for k in range(1, len(position)):
        step = position[k] - position[k - 1]
        limit = level[k] if step > 0.0 else -level[k]
        z = limit + (z - limit) * exp(-abs(step) / (presliding * level[k]))
        out[k] = z
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def void(rate: F, step_s: float) -> F:
    """Return the length [m] (n,), at least 0, of a void that opens at `rate` [m/s] (n,)."""
    out = np.empty_like(rate)
    z = 0.0
    out[0] = z
    for k in range(1, len(rate)):
        z = max(z + 0.5 * (rate[k - 1] + rate[k]) * step_s, 0.0)
        out[k] = z
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def void_length_at_limit(pull: F, onward: F, limit: float, passed: F, step_s: float) -> F:
    """Return the length [m] (n,) of a void that opens where the force `pull` [N] (n,) exceeds `limit`.

    It grows by the speed `onward` minus the flow `passed` of the valve, both [m/s] (n,), until it has closed. The
    instant of opening is interpolated between ticks, so that the length is continuous in `limit`.
    """
    out = np.zeros_like(pull)
    z = 0.0
    for k in range(1, len(pull)):
        if z > 0.0:
            z = max(z + 0.5 * (onward[k - 1] + onward[k] - passed[k - 1] - passed[k]) * step_s, 0.0)
        elif pull[k] > limit:
            rise = pull[k] - pull[k - 1]
            since = min(max((limit - pull[k - 1]) / rise, 0.0), 1.0) if rise > 0.0 else 1.0
            opened = onward[k - 1] + since * (onward[k] - onward[k - 1])
            z = max((0.5 * (onward[k] + opened) - passed[k]) * (1.0 - since) * step_s, 0.0)
        out[k] = z
    return out
