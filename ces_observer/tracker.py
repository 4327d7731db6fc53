"""The tracker: turns irregular position samples into the model's uniform ticks, causally.

Stamps [ns] and positions [m] go in; each sample yields zero or more ticks (position, speed at multiples of 1/rate).
A sample belongs to the next tick, at most half a period after it; `speed_bank.SpeedBank` takes it where it is, so a
jittered stream at the model's rate gives one tick per sample without delay. Further samples before that tick are
averaged. Lost ticks lie on the line between their neighbours. A silence longer than `max_gap_s` is never bridged.
With a delay, each tick also yields position and speed of the tick that long before, as they are known now.
`ces_identify.numerics.speed_kernels.track` computes the same over whole arrays; a test compares the two.

A position is plausible within the stroke, and within `outlier_m` of its prediction. After lost samples it is also
plausible if the piston can have reached it: to within `outlier_m` plus the effect of the largest change of speed while
no sample came. The largest change is MAX_CHANGE times the RMS speed of the identification recordings, from half that in
one direction to half in the other, and takes as long as the bank settles. Until it has settled after such a sample or a
restart, its speed may be as wrong, so the change is allowed at once.

This rejects every spike or jump beyond `outlier_m` while no samples are lost and, after a gap, positions that no
stroke could reach. It accepts a wrong position within reach, which after about ten lost samples is much of a damper's
stroke; the true positions after it are then rejected until they are within reach or accepted as a jump.

After a position that only a change of speed explains, or a silence longer than DOUBT settling times, speed and force
are uncertain: samples are UNSETTLED for that long. They are used, but their forces must not be published.
"""

from __future__ import annotations

from math import floor, isfinite
from typing import Any

from ces_observer.bank_design import SPEED
from ces_observer.model import Sampling
from ces_observer.speed_bank import SpeedBank

OK = "ok"
NOT_FINITE = "position or current is not finite"
OUT_OF_ORDER = "stamp repeats or runs backwards"
OUTLIER = "position is an outlier"
BEYOND_STROKE = "position is beyond the stroke"
RESTARTED = "started, or restarted after a gap or jump"
UNSETTLED = "settling after lost samples"
PATIENCE = 10  # outliers in a row after which the jump is accepted
OVERDUE = 1.5  # times 1/rate [s]: in a longer interval samples were lost, a shorter one may be jitter
SETTLING = 6.0  # times the bank's response: the time in which it settles
DOUBT = 3.0  # times that: until the model has settled, too, if the speed after lost samples is uncertain
MAX_CHANGE = 5.0  # times the RMS speed: of the speed, while no sample comes
MAX_MOTION = 1e6  # [m/s or m/s2]: a larger one is no measurement, and its likelihood would vanish

NEVER_NS = -(10**30)  # before any stamp by more than any gap

Tick = tuple[float, float]  # position [m] and speed [m/s]


class Tracker:
    """Uniform ticks from position samples.

    After `advance`, `ticks` holds those of the last sample, `late_ticks` what is known now of the ticks `delay` before
    them (None before the first tick), and `ahead` the sample's time after the last tick [ticks].
    """

    def __init__(self, sampling: Sampling) -> None:
        self._bank = SpeedBank(sampling.stroke, sampling.delay_ticks)
        self._tick_s = 1.0 / sampling.rate_Hz
        self._delays = sampling.delay_ticks > 0
        self._measured = sampling.motion == SPEED
        self._max_gap_ns = round(sampling.max_gap_s * 1e9)
        self._outlier_m = sampling.outlier_m
        self._low_m, self._high_m = sampling.stroke_m
        self._largest_change_m_s = MAX_CHANGE * sampling.speed_m_s
        self._overdue_s = OVERDUE / sampling.rate_Hz
        self._settling_s = SETTLING * self._bank.response_s
        self._settling_ticks = self._settling_s * sampling.rate_Hz
        self._doubt_s = DOUBT * self._settling_s
        self._doubt_ticks = DOUBT * self._settling_ticks
        self._scale = sampling.rate_Hz * 1e-9
        self.reset()

    def reset(self) -> None:
        """Forget every sample."""
        self._stamp_ns = NEVER_NS
        self._origin_ns = 0
        self._tau = self._settled_tau = self._doubted_tau = 0.0
        self._last_tick = 0
        self._rejected = 0
        self._last_interval_s = self._lost_s = 0.0  # of the samples rejected since the last accepted one
        self._waiting = 0  # samples before the next tick, and the sums of their positions and shifts
        self._positions = self._shifts = self._motion = 0.0
        self._unsettled = self._doubted = False
        self.ticks: list[Tick] = []
        self.late_ticks: list[Tick | None] = []
        self.ahead = 0.0
        self.position = self.speed = 0.0  # [m, m/s] at the last accepted sample

    def advance(self, stamp_ns: int, position: float, motion: float = 0.0) -> str:
        """Process a sample; set `ticks`, `late_ticks` and `ahead`. Return OK or a reason.

        `motion` is the measured speed [m/s] or acceleration [m/s2], if the sampling names one.
        """
        self.ticks, self.late_ticks = [], []
        if not (self._low_m <= position <= self._high_m and -MAX_MOTION <= motion <= MAX_MOTION):
            return BEYOND_STROKE if isfinite(position) and abs(motion) <= MAX_MOTION else NOT_FINITE
        step_ns = stamp_ns - self._stamp_ns
        if not 0 < step_ns <= self._max_gap_ns:
            return OUT_OF_ORDER if -self._max_gap_ns <= step_ns <= 0 else self._restart(stamp_ns, position, motion)
        interval = step_ns * 1e-9
        tau = (stamp_ns - self._origin_ns) * self._scale
        newest = floor(tau + 0.5)
        lost = newest - self._last_tick - 1  # ticks; -1: this sample is not the first of its tick
        bank = self._bank
        old, saved = (bank.position, bank.speed), self._coast(lost) if lost > 0 else None
        ahead = tau - newest
        shift = ahead if lost >= 0 else ahead - 1.0
        bend = 0.5 * shift * (bank.next_speed - bank.speed)
        innovation = position - (bank.next_position + shift * self._tick_s * (bank.next_speed + bend))
        doubtful = interval > self._overdue_s or not -self._outlier_m <= innovation <= self._outlier_m
        if doubtful and not self._believe(interval, innovation):
            if saved is not None:
                bank.restore(saved)
                self.late_ticks = []
            self._rejected += 1
            return OUTLIER if self._rejected <= PATIENCE else self._restart(stamp_ns, position, motion)
        self._rejected = 0
        self._stamp_ns, self._tau, self.ahead = stamp_ns, tau, ahead
        if lost == 0 and not self._waiting:  # as nearly always
            bank.update(1, position, shift, motion)
            self.ticks = [(bank.position, bank.speed)]
            if self._delays:
                self.late_ticks = [bank.late]
            self._last_tick = newest
        elif lost < 0:
            self._wait(position, shift, motion)
        else:
            self._measure(lost, old, position, shift, motion)
            self._last_tick = newest
        self.position = bank.position + ahead * (bank.next_position - bank.position)
        self.speed = bank.speed + ahead * (bank.next_speed - bank.speed)
        if self._unsettled:
            self._settle()
        return OK if tau >= self._doubted_tau else UNSETTLED

    def _coast(self, lost: int) -> dict[str, Any]:
        """Advance the bank by lost ticks, with the samples that wait for the first; return its state before."""
        saved = self._bank.save()
        for skipped in range(lost):
            if skipped == 0 and self._waiting:
                n = self._waiting
                self._bank.update(1, self._positions / n, self._shifts / n, self._motion)
            else:
                self._bank.coast()
            if self._delays:
                self.late_ticks.append(self._bank.late)
        return saved

    def _wait(self, position: float, shift: float, motion: float) -> None:
        """Keep a sample for the next tick, `shift` ticks after it."""
        self._waiting += 1
        self._positions += position
        self._shifts += shift
        self._motion = motion

    def _measure(self, lost: int, old: Tick, position: float, shift: float, motion: float) -> None:
        """Take a sample for the tick that it begins, with those that waited for it, after `lost` ticks."""
        bank, span = self._bank, lost + 1
        if self._waiting:
            if lost > 0:
                span = lost  # they were taken in the first lost tick
            else:
                n = self._waiting + 1
                position, shift = (self._positions + position) / n, (self._shifts + shift) / n
            self._waiting = 0
            self._positions = self._shifts = 0.0
        bank.update(span, position, shift, motion)
        for tick in range(1, lost + 1):
            share = tick / (lost + 1)
            x = old[0] + share * (bank.position - old[0])
            self.ticks.append((x, old[1] + share * (bank.speed - old[1])))
        self.ticks.append((bank.position, bank.speed))
        if self._delays:
            self.late_ticks.append(bank.late)

    def _believe(self, interval: float, innovation: float) -> bool:
        """Return whether a position that is late or far from its prediction is plausible."""
        lost_s = self._count_lost(interval)
        self._unsettled, self._doubted = lost_s > 0.0, lost_s > self._doubt_s
        if abs(innovation) > self._outlier_m:
            if not self._within_reach(interval, lost_s, innovation):
                self._unsettled = self._doubted = False
                return False
            self._unsettled = self._doubted = True
        return True

    def _settle(self) -> None:
        """Note until when speed and force are uncertain after the newest sample."""
        self._settled_tau = self._tau + self._settling_ticks
        if self._doubted:
            self._doubted_tau = self._tau + self._doubt_ticks
        self._unsettled = self._doubted = False

    def _count_lost(self, interval: float) -> float:
        """Return for how long [s] of `interval`, since the last accepted sample, samples were overdue."""
        if self._rejected == 0:
            self._last_interval_s = self._lost_s = 0.0
        self._lost_s += max(interval - self._last_interval_s - self._overdue_s, 0.0)
        self._last_interval_s = interval
        return self._lost_s

    def _within_reach(self, interval: float, lost_s: float, deviation: float) -> bool:
        """Return whether a change of speed explains a `deviation` [m] from the prediction in `interval` [s]."""
        ramp = self._settling_s
        if self._tau < self._settled_tau:
            changed = interval
        else:
            changed = lost_s - 0.5 * ramp if lost_s > ramp else 0.5 * lost_s * lost_s / ramp
        return changed > 0.0 and abs(deviation) <= self._outlier_m + self._largest_change_m_s * changed

    def _restart(self, stamp_ns: int, position: float, motion: float) -> str:
        self.reset()
        self._bank.reset(position, motion if self._measured else 0.0)
        self._stamp_ns = self._origin_ns = stamp_ns
        self._settled_tau = self._settling_ticks
        self.position, self.speed = position, self._bank.speed
        self.ticks.append((position, self.speed))
        if self._delays:
            self.late_ticks.append(None)
        return RESTARTED
