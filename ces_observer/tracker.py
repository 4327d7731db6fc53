"""From irregular position samples to the model's uniform ticks, causally.

Stamps [ns] and positions [m] go in; zero or more ticks (position, speed at whole multiples of 1/rate) come out of
each sample. Ticks up to half a period ahead of the newest sample are extrapolated by the differentiator's own
acceleration, so a jittered stream at the model's rate gives one tick per sample and no delay; dropped samples and
streams at other rates are bridged by interpolation. A silence longer than `max_gap_s` is never bridged.
`ces_identify.kernels.track` is this class over whole arrays; a test holds the two together.
"""

from __future__ import annotations

from math import floor, isfinite

from ces_observer.differentiator import Differentiator
from ces_observer.model import Sampling

OK = "ok"
NOT_FINITE = "position or current is not finite"
OUT_OF_ORDER = "stamp repeats or runs backwards"
OUTLIER = "position is an outlier"
RESTARTED = "started, or restarted after a gap or jump"
PATIENCE = 10  # outliers in a row after which the jump is believed


class Tracker:
    """Uniform ticks from position samples; `ticks` holds the (position, speed) pairs of the last sample."""

    __slots__ = (
        "_differentiator",
        "_last_tick",
        "_max_gap_ns",
        "_origin_ns",
        "_outlier_m",
        "_rejected",
        "_scale",
        "_stamp_ns",
        "_tau",
        "ahead",
        "ticks",
    )

    def __init__(self, sampling: Sampling) -> None:
        self._differentiator = Differentiator(sampling.bandwidth_Hz, sampling.order)
        self._max_gap_ns = round(sampling.max_gap_s * 1e9)
        self._outlier_m = sampling.outlier_m
        self._scale = sampling.rate_Hz * 1e-9
        self.reset()

    def reset(self) -> None:
        """Forget every sample."""
        self._stamp_ns: int | None = None
        self._origin_ns = 0
        self._tau = 0.0
        self._last_tick = 0
        self._rejected = 0
        self.ticks: list[tuple[float, float]] = []
        self.ahead = 0.0

    @property
    def position(self) -> float:
        """Filtered position [m] at the last accepted sample."""
        return self._differentiator.position

    @property
    def speed(self) -> float:
        """Speed [m/s] at the last accepted sample."""
        return self._differentiator.speed

    def advance(self, stamp_ns: int, position: float) -> str:
        """Take a sample; fills `ticks`, and `ahead` with the sample's time after the last tick [ticks]."""
        self.ticks.clear()
        if not isfinite(position):
            return NOT_FINITE
        if self._stamp_ns is None:
            return self._restart(stamp_ns, position)
        step_ns = stamp_ns - self._stamp_ns
        if step_ns > self._max_gap_ns or step_ns < -self._max_gap_ns:
            return self._restart(stamp_ns, position)
        if step_ns <= 0:
            return OUT_OF_ORDER
        interval = step_ns * 1e-9
        innovation = position - self._differentiator.predict(interval)
        if abs(innovation) > self._outlier_m:
            self._rejected += 1
            return OUTLIER if self._rejected <= PATIENCE else self._restart(stamp_ns, position)
        self._rejected = 0
        self._accept(stamp_ns, interval, position, innovation)
        return OK

    def _restart(self, stamp_ns: int, position: float) -> str:
        self._differentiator.reset(position)
        self._stamp_ns = self._origin_ns = stamp_ns
        self._tau = self.ahead = 0.0
        self._last_tick = self._rejected = 0
        self.ticks.append((position, 0.0))
        return RESTARTED

    def _accept(self, stamp_ns: int, interval: float, position: float, innovation: float) -> None:
        d = self._differentiator
        old_position, old_speed, old_tau = d.position, d.speed, self._tau
        d.correct(interval, position, innovation)
        self._stamp_ns = stamp_ns
        self._tau = tau = (stamp_ns - self._origin_ns) * self._scale
        newest, tick = floor(tau + 0.5), self._last_tick
        while tick < newest:
            tick += 1
            if tick <= tau:
                share = (tick - old_tau) / (tau - old_tau)
                x = old_position + share * (d.position - old_position)
                v = old_speed + share * (d.speed - old_speed)
            else:
                lead = (tick - tau) / (tau - old_tau) * interval
                x = d.position + lead * d.speed
                v = d.speed + lead * d.acceleration
            self.ticks.append((x, v))
        self._last_tick = newest
        self.ahead = tau - newest
