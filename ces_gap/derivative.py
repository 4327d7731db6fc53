"""The derivative of uniform samples, used for every speed, acceleration and rate of force in `ces_gap`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F = NDArray[np.float64]


def derivative(values: F, rate_Hz: float) -> F:
    """Return the derivative of uniform samples (n,), central differences of fourth order, lower at the ends."""
    out: F = np.gradient(values) * rate_Hz
    if len(values) > 4:
        out[2:-2] = (8.0 * (values[3:-1] - values[1:-3]) - (values[4:] - values[:-4])) * (rate_Hz / 12.0)
    return out
