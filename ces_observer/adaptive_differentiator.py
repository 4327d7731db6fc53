"""The adaptive differentiator: three Kalman filters of different bandwidths, weighted by how well each predicts.

A slow stroke needs little bandwidth and a fast one much. Each filter is a `Differentiator`; its one-step prediction
errors e have the variance S = noise^2 / (1 - gain of the position) if its bandwidth suits the stroke. The output is
the mean of the filters with the weights exp(score), where every sample adds -(e^2 / S + ln S) / 2 to a score and scores
fade with MEMORY_S: a static multiple-model estimator (Bar-Shalom, Li & Kirubarajan, Estimation with Applications to
Tracking and Navigation, sec. 11.6) with a fading memory. The weights are positive and sum to one, so the output lies
between those of the filters, each of which is stable. docs/speed.md compares it with a fixed bandwidth.
"""

from __future__ import annotations

from math import exp, log

from ces_observer.differentiator import Differentiator

SHARES = (0.5, 0.79, 1.26)  # bandwidths of the filters over the stated bandwidth
MEMORY_S = 0.1  # [s] time constant in which a score fades
NOISE_SHARE = 0.6  # of the noise's variance: less than 1 prefers bandwidth, because the damper itself smooths noise
MAX_SQUARE = 25.0  # of e / sqrt(S), so that one wild sample does not decide for long


class AdaptiveDifferentiator:
    """Filtered position [m], speed [m/s] and acceleration [m/s2], as `Differentiator` has them.

    `noise_m` is the RMS noise of the position samples; the filters have SHARES of `bandwidth_Hz`.
    """

    def __init__(self, bandwidth_Hz: float, order: int, noise_m: float) -> None:
        self._filters = tuple(Differentiator(share * bandwidth_Hz, order) for share in SHARES)
        self._variance = NOISE_SHARE * noise_m * noise_m
        self.reset(0.0)

    def reset(self, position: float) -> None:
        """Restart at rest at `position` [m]."""
        for one in self._filters:
            one.reset(position)
        self._scores = [0.0] * len(SHARES)
        self.position = position
        self.speed = self.acceleration = 0.0

    def predict(self, interval: float) -> float:
        """Return the position [m] expected `interval` seconds after the last sample."""
        return self.position + interval * (self.speed + 0.5 * interval * self.acceleration)

    def coast(self) -> None:
        """Forget the acceleration, as after a jump of it while no sample came."""
        for one in self._filters:
            one.coast()
        self.acceleration = 0.0

    def correct(self, interval: float, position: float, innovation: float) -> None:
        """Take the position [m] measured `interval` > 0 seconds after the last sample; the filters have their own
        innovations."""
        del innovation
        fade = exp(-interval / MEMORY_S)
        for i, one in enumerate(self._filters):
            error = position - one.predict(interval)
            one.correct(interval, position, error)
            square = min(error * error * one.confidence / self._variance, MAX_SQUARE)
            self._scores[i] = fade * self._scores[i] - 0.5 * (square - log(one.confidence))
        self._combine()

    def _combine(self) -> None:
        best = max(self._scores)
        total = x = v = a = 0.0
        for score, one in zip(self._scores, self._filters, strict=True):
            weight = exp(score - best)
            total += weight
            x += weight * one.position
            v += weight * one.speed
            a += weight * one.acceleration
        self.position, self.speed, self.acceleration = x / total, v / total, a / total
