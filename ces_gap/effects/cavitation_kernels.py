"""Compiled loop of a chamber whose pressure has fallen to nothing: the void that holds the force at its limit."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F = NDArray[np.float64]


@njit(cache=True, nogil=True, error_model="numpy")
def void_length_at_limit(pull: F, onward: F, limit: float, passed: F, step_s: float) -> F:
    """Return the length [m] (n,) of a void that opens where the force `pull` [N] (n,) passes `limit`.

    Beside it the valve goes on passing `passed` [m/s] (n,), so it grows by the speed `onward` [m/s] (n,) less that
    until it has closed. The instant of opening lies between ticks, so that the length is continuous in `limit`.
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
