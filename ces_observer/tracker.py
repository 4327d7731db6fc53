"""The tracker: turns irregular position samples into the model's uniform ticks, causally.

Stamps [ns] and positions [m] go in; each sample yields zero or more ticks (position, speed at multiples of 1/rate).
Ticks up to half a period ahead of the newest sample are extrapolated with the differentiator's acceleration, so a
jittered stream at the model's rate gives one tick per sample without delay. Lost samples and other rates are
interpolated. A silence longer than `max_gap_s` is never bridged. `ces_identify.numerics.kernels.track` computes the
same over whole arrays; a test compares the two.

A position is plausible within `outlier_m` of the differentiator's prediction. After lost samples it is also plausible
if the piston can have reached it: from its last speed, with or without its last acceleration, to within `outlier_m`
plus the effect of the largest change of speed while no sample came. `outlier_m` is at least the RMS speed of the
identification data / (2 pi bandwidth) (`ces_identify.prepare.sampling`). The largest change is LARGEST_CHANGE
times that speed, from 2.5 times the RMS speed in one direction to the same in the other, and takes as long as the
differentiator settles. Until it has settled after such a sample or a restart, its speed may be as wrong, so the change
is allowed at once.

This rejects every spike or jump beyond `outlier_m` while no samples are lost and, after a gap, positions that no
stroke could reach. It accepts a wrong position within reach, which after about ten lost samples is much of a damper's
stroke; the true positions after it are then rejected until they are within reach or accepted as a jump.

After a position that only a change of speed explains, or a silence longer than DOUBT settling times, speed and force
are uncertain: samples are UNSETTLED for that long. They are used, but their forces must not be published.
"""

from __future__ import annotations

from math import floor, isfinite, pi

from ces_observer.adaptive_differentiator import AdaptiveDifferentiator
from ces_observer.differentiator import Differentiator
from ces_observer.model import ADAPTIVE, FUSED, MEASURED, Sampling

OK = "ok"
NOT_FINITE = "position or current is not finite"
OUT_OF_ORDER = "stamp repeats or runs backwards"
OUTLIER = "position is an outlier"
RESTARTED = "started, or restarted after a gap or jump"
UNSETTLED = "settling after lost samples"
PATIENCE = 10  # outliers in a row after which the jump is accepted
OVERDUE = 1.5  # times 1/rate [s]: in a longer interval samples were lost, a shorter one may be jitter
SETTLING = 3.0  # over 2 pi bandwidth [s]: the time in which the differentiator settles
DOUBT = 5.0  # times that: until the model has settled, too, if the speed after lost samples is uncertain
LARGEST_CHANGE = 5.0  # times outlier_m * 2 pi bandwidth [m/s]: of speed, while no sample comes


def make_differentiator(sampling: Sampling) -> Differentiator | AdaptiveDifferentiator:
    """Return the filter that computes position and speed; with a measured speed, the position only."""
    if sampling.differentiator == ADAPTIVE:
        return AdaptiveDifferentiator(sampling.bandwidth_Hz, sampling.order, sampling.noise_m)
    return Differentiator(sampling.bandwidth_Hz, sampling.order)


class Tracker:
    """Uniform ticks from position samples; `ticks` holds the (position, speed) pairs of the last sample."""

    def __init__(self, sampling: Sampling) -> None:
        self._differentiator = make_differentiator(sampling)
        self._fused = sampling.differentiator == FUSED
        self._measured = sampling.differentiator == MEASURED
        self._max_gap_ns = round(sampling.max_gap_s * 1e9)
        self._outlier_m = sampling.outlier_m
        self._largest_change_m_s = LARGEST_CHANGE * 2.0 * pi * sampling.bandwidth_Hz * sampling.outlier_m
        self._overdue_s = OVERDUE / sampling.rate_Hz
        self._settling_s = SETTLING / (2.0 * pi * sampling.bandwidth_Hz)
        self._settling_ticks = self._settling_s * sampling.rate_Hz
        self._doubt_s = DOUBT * self._settling_s
        self._doubt_ticks = DOUBT * self._settling_ticks
        self._scale = sampling.rate_Hz * 1e-9
        self.reset()

    def reset(self) -> None:
        """Forget every sample."""
        self._stamp_ns: int | None = None
        self._origin_ns = 0
        self._tau = self._settled_tau = self._doubted_tau = 0.0
        self._last_tick = 0
        self._rejected = 0
        self._last_interval_s = self._lost_s = 0.0  # of the samples rejected since the last accepted one
        self.ticks: list[tuple[float, float]] = []
        self.ahead = 0.0
        self.speed = 0.0  # [m/s] at the last accepted sample
        self._motion = self._bias = 0.0  # [m/s2] measured acceleration, and what the position adds to it

    @property
    def position(self) -> float:
        """Filtered position [m] at the last accepted sample."""
        return self._differentiator.position

    def advance(self, stamp_ns: int, position: float, motion: float = 0.0) -> str:
        """Process a sample; set `ticks` and `ahead`, its time after the last tick [ticks]. Return OK or a reason.

        `motion` is the measured speed [m/s] or acceleration [m/s2], if the sampling's differentiator needs one.
        """
        self.ticks.clear()
        if not isfinite(position + motion):
            return NOT_FINITE
        if self._stamp_ns is None:
            return self._restart(stamp_ns, position, motion)
        step_ns = stamp_ns - self._stamp_ns
        if step_ns > self._max_gap_ns or step_ns < -self._max_gap_ns:
            return self._restart(stamp_ns, position, motion)
        if step_ns <= 0:
            return OUT_OF_ORDER
        interval = step_ns * 1e-9
        if self._fused:
            self._differentiator.acceleration = self._bias + 0.5 * (self._motion + motion)
        innovation = position - self._differentiator.predict(interval)
        if interval > self._overdue_s or abs(innovation) > self._outlier_m:
            return self._advance_doubtful(stamp_ns, interval, position, innovation, motion)
        self._rejected = 0
        self._accept(stamp_ns, interval, position, innovation, motion)
        return OK if self._tau >= self._doubted_tau else UNSETTLED

    def _advance_doubtful(
        self, stamp_ns: int, interval: float, position: float, innovation: float, motion: float
    ) -> str:
        """Process a sample that is late or far from its prediction."""
        lost = self._count_lost(interval)
        unsettled, doubted = lost > 0.0, lost > self._doubt_s
        if abs(innovation) > self._outlier_m:
            d = self._differentiator
            coasted = position - (d.position + interval * d.speed)
            coasts = abs(coasted) < abs(innovation) and not self._fused
            innovation = coasted if coasts else innovation
            if not self._within_reach(interval, lost, innovation):
                self._rejected += 1
                return OUTLIER if self._rejected <= PATIENCE else self._restart(stamp_ns, position, motion)
            if coasts:
                d.coast()
            unsettled = doubted = True
        self._rejected = 0
        self._accept(stamp_ns, interval, position, innovation, motion)
        if unsettled:
            self._settled_tau = self._tau + self._settling_ticks
        if doubted:
            self._doubted_tau = self._tau + self._doubt_ticks
        return OK if self._tau >= self._doubted_tau else UNSETTLED

    def _count_lost(self, interval: float) -> float:
        """Return for how long [s] of `interval`, since the last accepted sample, samples were overdue."""
        if self._rejected == 0:
            self._last_interval_s = self._lost_s = 0.0
        self._lost_s += max(interval - self._last_interval_s - self._overdue_s, 0.0)
        self._last_interval_s = interval
        return self._lost_s

    def _within_reach(self, interval: float, lost: float, deviation: float) -> bool:
        """Return whether a change of speed explains a `deviation` [m] from the prediction in `interval` [s]."""
        ramp = self._settling_s
        if self._tau < self._settled_tau:
            changed = interval
        else:
            changed = lost - 0.5 * ramp if lost > ramp else 0.5 * lost * lost / ramp
        return changed > 0.0 and abs(deviation) <= self._outlier_m + self._largest_change_m_s * changed

    def _restart(self, stamp_ns: int, position: float, motion: float) -> str:
        self._differentiator.reset(position)
        self.speed = motion if self._measured else 0.0
        self._motion, self._bias = motion, 0.0
        self._stamp_ns = self._origin_ns = stamp_ns
        self._tau = self.ahead = self._doubted_tau = 0.0
        self._settled_tau = self._settling_ticks
        self._last_tick = self._rejected = 0
        self.ticks.append((position, self.speed))
        return RESTARTED

    def _accept(self, stamp_ns: int, interval: float, position: float, innovation: float, motion: float) -> None:
        d = self._differentiator
        old_position, old_speed, old_tau = d.position, self.speed, self._tau
        d.correct(interval, position, innovation)
        if self._fused:
            self._bias = d.acceleration - 0.5 * (self._motion + motion)
            self._motion = motion
            d.acceleration = self._bias + motion
        self.speed = speed = motion if self._measured else d.speed
        self._stamp_ns = stamp_ns
        self._tau = tau = (stamp_ns - self._origin_ns) * self._scale
        newest, tick = floor(tau + 0.5), self._last_tick
        while tick < newest:
            tick += 1
            if tick <= tau:
                share = (tick - old_tau) / (tau - old_tau)
                x = old_position + share * (d.position - old_position)
                v = old_speed + share * (speed - old_speed)
            else:
                lead = (tick - tau) / (tau - old_tau) * interval
                x = d.position + lead * speed
                v = speed + lead * d.acceleration
            self.ticks.append((x, v))
        self._last_tick = newest
        self.ahead = tau - newest
