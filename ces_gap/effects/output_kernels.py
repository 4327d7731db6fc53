"""The numerical kernel of effects that act on the force: a plain loop over ticks, compiled by Numba.

Its slow readable twin is in the tests.
"""

from __future__ import annotations

from math import exp

import numpy as np
from numba import njit
from numpy.typing import NDArray

F = NDArray[np.float64]


@njit(cache=True, nogil=True)
def bristles(position: F, level: F, presliding: float) -> F:
    """Return the friction z (n,) of bristles that start unbent, over that of plain sliding.

    dz/dx = (1 - z sign(dx) / level) / presliding, integrated exactly over each tick for the tick's `level` (n,): the
    bristles tend to +-level over `presliding` * level of stroke [m] (Dahl 1968; Canudas de Wit et al. 1995).
    """
    out = np.zeros(len(position))
    z = 0.0
    for k in range(1, len(position)):
        step = position[k] - position[k - 1]
        limit = level[k] if step > 0.0 else -level[k]
        z = limit + (z - limit) * exp(-abs(step) / (presliding * level[k]))
        out[k] = z
    return out
