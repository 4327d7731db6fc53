"""The differentiator: a causal filter that computes speed from position and tolerates jitter.

Position samples and their intervals go in; filtered position, speed and acceleration at each sample come out. It is
the steady-state Kalman filter of a chain of `order` integrators driven by white noise; its poles form a Butterworth
pattern of radius `bandwidth` (Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation,
sec. 6.5). Order 3 (white jerk) has no delay at low frequency; order 2 (white acceleration) lags by
1.41 / (2 pi bandwidth) but does not amplify signals near the bandwidth. The poles are placed again when the interval
changes, so the bandwidth is the same at any sampling rate. docs/speed.md compares the alternatives.
"""

from __future__ import annotations

from math import cos, exp, isfinite, pi, sqrt

from ces_observer.errors import ModelError

ORDERS = (2, 3)


class Differentiator:
    """Filtered position [m], speed [m/s] and acceleration [m/s2, 0 in order 2] after each `step`."""

    def __init__(self, bandwidth_Hz: float, order: int = 3) -> None:
        if not (isfinite(bandwidth_Hz) and bandwidth_Hz > 0.0):
            raise ModelError(f"differentiator bandwidth is {bandwidth_Hz!r} Hz; expected a positive number")
        if order not in ORDERS:
            raise ModelError(f"differentiator order is {order!r}; expected 2 or 3")
        self.bandwidth_Hz = bandwidth_Hz
        self.order = order
        damping = 0.5 if order == 3 else sqrt(0.5)
        self._decay = -damping * 2.0 * pi * bandwidth_Hz
        self._turn = sqrt(1.0 - damping * damping) * 2.0 * pi * bandwidth_Hz
        self._interval = 0.0  # none yet
        self.reset(0.0)

    def reset(self, position: float) -> None:
        """Restart at rest at `position` [m]."""
        self.position = position
        self.speed = 0.0
        self.acceleration = 0.0

    def predict(self, interval: float) -> float:
        """Return the position [m] expected `interval` seconds after the last sample."""
        return self.position + interval * (self.speed + 0.5 * interval * self.acceleration)

    def step(self, interval: float, position: float) -> None:
        """Take the position [m] measured `interval` > 0 seconds after the last sample."""
        self.correct(interval, position, position - self.predict(interval))

    def correct(self, interval: float, position: float, innovation: float) -> None:
        """Take a step whose `innovation` [m], the position minus its prediction, is known already."""
        if interval != self._interval:
            self._place_poles(interval)
        self.speed += interval * self.acceleration + self._second * innovation / interval
        self.acceleration += self._twice_third * innovation / (interval * interval)
        self.position = position - self._product * innovation

    def coast(self) -> None:
        """Forget the acceleration, as after a jump of it while no sample came."""
        self.acceleration = 0.0

    @property
    def confidence(self) -> float:
        """The position noise's variance over that of the predictions' errors, at the last interval."""
        return self._product

    def _place_poles(self, interval: float) -> None:
        radius = exp(self._decay * interval)
        pair = 2.0 * radius * cos(self._turn * interval)
        square = radius * radius
        if self.order == 3:  # the real pole exp(-2 pi bandwidth interval) is `square` too
            self._product = square * square
            third = 0.5 * (1.0 - square) * (1.0 - pair + square)
            self._second = self._product + 2.0 - pair - square - third
        else:
            self._product, third = square, 0.0
            self._second = 1.0 - pair + square
        self._twice_third = 2.0 * third
        self._interval = interval
