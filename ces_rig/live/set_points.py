"""A stroke that follows set points from outside: a critically damped actuator of second order, limited to a reach."""

from __future__ import annotations

from math import exp, isfinite, pi

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Follower:
    """Follows the newest set point at grid points every `interval_s`; a set point that is not finite is refused."""

    def __init__(self, bandwidth_Hz: float, reach_m: float, interval_s: float) -> None:
        self.start = 0.0, 0.0
        self._omega, self._reach_m, self._interval_s = 2.0 * pi * bandwidth_Hz, reach_m, interval_s
        self._decay = exp(-self._omega * interval_s)
        self._wanted_m = self._stroke_m = self._speed_m_s = 0.0

    def set_stroke(self, stroke_m: float) -> None:
        """Accept a set point, limited to the reach."""
        if isfinite(stroke_m):
            self._wanted_m = min(max(stroke_m, -self._reach_m), self._reach_m)

    def moves(self, count: int) -> tuple[Array, Array]:
        """Return the next `count` strokes [m] and speeds [m/s].

        Between set points the distance e obeys e'' + 2 w e' + w² e = 0, solved exactly: no overshoot, any interval.
        """
        out, w, h = np.empty((2, count)), self._omega, self._interval_s
        for k in range(count):
            distance = self._stroke_m - self._wanted_m
            slope = self._speed_m_s + w * distance
            self._stroke_m = self._wanted_m + (distance + slope * h) * self._decay
            self._speed_m_s = (slope - w * (distance + slope * h)) * self._decay
            out[:, k] = self._stroke_m, self._speed_m_s
        return out[0], out[1]
