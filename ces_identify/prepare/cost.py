"""The cost of thesis eq. 3.5, J = 100 ||y - y^|| / ||y - mean(y)||, on the scored ticks of a free run."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ces_identify.limits import TickLimits
from ces_identify.prepare.series import Series
from ces_observer.errors import RecordingError


def cost(measured: NDArray[np.float64], simulated: NDArray[np.float64]) -> float:
    """Return J [%] of two arrays of shape (n,); infinite if `simulated` has a non-finite value."""
    if not np.isfinite(simulated).all():
        return float("inf")
    spread = np.linalg.norm(measured - measured.mean())
    return float(100.0 * np.linalg.norm(measured - simulated) / spread)


def series_cost(series: Series, simulated: NDArray[np.float64]) -> float:
    """Return J [%] of a simulated force (ticks,) on the scored ticks of `series`."""
    scored = series.scored
    return cost(series.force[scored], simulated[scored])


def require_force(series: Series) -> None:
    """Raise RecordingError if the measured force of `series` is too short or constant."""
    count = int(series.scored.sum())
    if count < TickLimits.MIN_SCORED:
        text = f"{count} ticks with a measured force past warm-up; expected at least {TickLimits.MIN_SCORED}"
        raise RecordingError(f"{series.name}: {text}")
    if np.ptp(series.force[series.scored]) == 0.0:
        raise RecordingError(
            f"{series.name}: measured force is constant; check its topic and field in the signals file"
        )
