"""Speed from position, causally: a third-order observer that is exact for constant acceleration and tolerates jitter.

Position samples with their intervals go in; filtered position, speed and acceleration come out at each sample's time.
It is the steady-state Kalman filter of a triple integrator (white jerk, white position noise), whose poles form a
Butterworth pattern of radius `bandwidth` = (jerk intensity / noise intensity)^(1/6); see Bar-Shalom, Li &
Kirubarajan, Estimation with Applications to Tracking and Navigation, sec. 6.5. Placing the poles anew for each
interval keeps the same bandwidth at any sampling rate. docs/differentiator.md says why this one.
"""

from __future__ import annotations

from math import cos, exp, isfinite, pi, sqrt

from ces_observer.errors import ModelError


class Differentiator:
    """Filtered position [m], speed [m/s] and acceleration [m/s2] after each `step`."""

    __slots__ = ("_half", "_turn", "acceleration", "bandwidth_Hz", "position", "speed")

    def __init__(self, bandwidth_Hz: float) -> None:
        if not (isfinite(bandwidth_Hz) and bandwidth_Hz > 0.0):
            raise ModelError(f"differentiator bandwidth is {bandwidth_Hz!r} Hz; expected a positive number")
        self.bandwidth_Hz = bandwidth_Hz
        self._half = -0.5 * 2.0 * pi * bandwidth_Hz
        self._turn = sqrt(0.75) * 2.0 * pi * bandwidth_Hz
        self.reset(0.0)

    def reset(self, position: float) -> None:
        """Start anew at rest at `position` [m]."""
        self.position = position
        self.speed = 0.0
        self.acceleration = 0.0

    def predict(self, interval: float) -> float:
        """Return the position [m] expected `interval` seconds after the last sample."""
        return self.position + interval * (self.speed + 0.5 * interval * self.acceleration)

    def step(self, interval: float, position: float) -> None:
        """Take the position [m] measured `interval` > 0 seconds after the last sample."""
        radius = exp(self._half * interval)
        pair = 2.0 * radius * cos(self._turn * interval)
        real = radius * radius
        total, pairs, product = real + pair, real + pair * real, real * real
        third = 0.5 * (1.0 - total + pairs - product)
        second = product + 2.0 - total - third
        innovation = position - self.predict(interval)
        self.position = position - product * innovation
        self.speed += interval * self.acceleration + second * innovation / interval
        self.acceleration += 2.0 * third * innovation / (interval * interval)
