"""The force controller: speed and estimated force in, valve current out, so that the damper's force follows a curve.

    desired  = curve(speed), clipped to the forces within the current limits      (counted: a damper only dissipates)
    ahead    = inverse map(speed in preview_s, desired force at that speed)       (feed-forward)
    trim'    = loop_gain * slope / (slope^2 + typical^2) * (desired - force)      (feedback; slope = dF/di)
    command  = ahead + trim, with a lead against the valve's lag; then the current limits and the rate limit

**Feed-forward** is the fast part. It compensates delays: transport, the filters, and the valve, whose force follows
the current several milliseconds later. `preview_s` predicts the speed, and the lead (1 + valve_lag s) /
(1 + lead_filter s) compensates the rest of the lag within the limits; both amplify noise by about their ratio to
`lead_filter_s`.

**Feedback** is the slow part: it learns the errors of the map as two trims of the current, for compression and for
rebound, because the errors are independent. It cannot follow the stroke: with a valve lag of 10 ms its bandwidth ends
where the motion of road and wheel begins. After a reversal, oil and bushing yield before the force builds up, at any
current; this error is not the map's, so the force is fed back only after `settle_m` of stroke. dF/di gives the sign
(negative in rebound) and schedules the gain: loop_gain * slope^2 / (slope^2 + typical^2) [1/s], which is nearly
constant at all speeds where current changes the force, at most `loop_gain_1_s`, and almost zero near standstill.

**Margin.** From trim to force the plant is slope / (1 + lag s), with a delay T of transport and estimation. If the
lead has no effect, the open loop is L(s) = g / s * exp(-T s) / (1 + lag s), g <= loop_gain. Its phase margin is at
least 90 deg - 57.3 deg * g (T + lag), its gain margin at least 1 / (g (T + lag)). The defaults give 86 deg and 16 at
lag = 10 ms, T = 5 ms; slopes wrong by a factor of 3 together with a valve five times slower leave 52 deg and 1.5.
Hysteresis of the valve shifts the current by a bounded amount, which the trims learn.

If estimates stop, are stale or not finite, the command goes to the safe current at the rate limit. Afterwards it fades
in within `recovery_s`, from the safe current and with trims of zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import nan

from ces_observer.control.controller_tuning import Tuning
from ces_observer.control.force_curve import ForceCurve
from ces_observer.control.inverse_map import InverseMap
from ces_observer.control.lead import Lead

OK = "ok"
NO_ESTIMATE = "no estimates arrive"
STALE = "the estimate is stale"
NOT_FINITE = "the estimate is not finite"
JUMP_NS = 1_000_000_000  # a stamp this much before the last one shows that the clock was set back
FASTEST_M_S = 1e6  # a larger speed is invalid; far from where sums overflow
LARGEST_N = 1e9  # as of a model's force envelope


@dataclass
class ControllerCounts:
    """Counts since the start: steps that followed the curve, of these the special ones, and interruptions by reason."""

    steps: int = 0
    unreachable: int = 0  # the damper cannot reach the desired force at this speed
    saturated: int = 0  # command at a current limit
    rate_limited: int = 0
    unfed: int = 0  # without a usable force to feed back
    interruptions: dict[str, int] = field(default_factory=dict)


class ForceController:
    """One damper's controller.

    After `step`: `command_A` is the current to command, `desired_N` the curve's force, `reachable_N` that force clipped
    to what the damper can do (both NaN with the safe current), `reason` "ok" or why the safe current is commanded.
    Every command is finite and obeys the current and rate limits.
    """

    def __init__(self, curve: ForceCurve, inverse: InverseMap, tuning: Tuning) -> None:
        self.curve = curve
        self.inverse = inverse
        self.tuning = tuning
        self.count = ControllerCounts()
        self.command_A = tuning.safe_A
        self._typical_slope = _typical_slope(inverse)
        self._before: tuple[InverseMap, Sequence[float]] | None = None  # map and trims that fade out after `adopt`
        self._share = 0.0  # 0 to 1: weight of the new map and trims
        self._speed_lead, self._valve_lead = Lead(), Lead()
        self._trims = [0.0, 0.0]  # [A] in rebound, in compression
        self._stroke = 0.0  # [m] since the last reversal
        self._authority = 0.0  # 0 to 1: weight of the controller against the safe current
        self.reset()

    def reset(self) -> None:
        """Bring the controller back to new, except for its last command and its counts."""
        self.reason = NO_ESTIMATE
        self._stamp_ns: int | None = None
        self._interrupt()

    @property
    def trims_A(self) -> tuple[float, float]:
        """The trims [A] in rebound and in compression."""
        return self._trims[0], self._trims[1]

    def adopt(self, inverse: InverseMap) -> None:
        """Change to the map `inverse`: it fades in within `recovery_s`.

        The trims start at zero, because they held the old map's errors, and do not learn until the change is complete.
        """
        self._before, self._share = (self.inverse, self._trims), 0.0
        self.inverse, self._typical_slope = inverse, _typical_slope(inverse)
        self._trims = [0.0, 0.0]

    def step(self, stamp_ns: int, speed_m_s: float, force_N: float) -> float:
        """Return the current [A] for an estimate of this stamp; a force that is not finite is not fed back.

        A stamp that repeats, or runs back by less than JUMP_NS, changes nothing; after a gap longer than `max_gap_s`,
        or a jump back, the controller restarts.
        """
        elapsed_ns = -JUMP_NS if self._stamp_ns is None else stamp_ns - self._stamp_ns
        if -JUMP_NS < elapsed_ns <= 0:
            return self.command_A
        self._stamp_ns = stamp_ns
        elapsed_s = elapsed_ns * 1e-9 if elapsed_ns > 0 else 0.0
        if not abs(speed_m_s) < FASTEST_M_S:
            return self.fail_safe(NOT_FINITE, min(elapsed_s, self.tuning.max_gap_s))
        if elapsed_s == 0.0 or elapsed_s > self.tuning.max_gap_s:
            self._interrupt()
            elapsed_s = 0.0
        self.reason = OK
        self.count.steps += 1
        return self._follow(speed_m_s, force_N, elapsed_s)

    def fail_safe(self, reason: str, elapsed_s: float) -> float:
        """Return the next current [A] on the way to the safe one, `elapsed_s` after the last command."""
        if reason != self.reason:
            self.count.interruptions[reason] = self.count.interruptions.get(reason, 0) + 1
            self.reason = reason
        self._interrupt()
        return self._command(self.tuning.safe_A, elapsed_s)

    def _follow(self, speed: float, force: float, elapsed_s: float) -> float:
        self.desired_N = self.curve.at(speed)
        self.reachable_N = self._clip_to_reachable(self.inverse, speed)
        self.count.unreachable += self.reachable_N != self.desired_N
        self._learn(speed, force, elapsed_s)
        tuning = self.tuning
        soon = self._speed_lead.step(speed, elapsed_s, tuning.preview_s + tuning.lead_filter_s, tuning.lead_filter_s)
        current = tuning.clip_current(self._compute_current(soon, elapsed_s))
        leading = self._valve_lead.step(current, elapsed_s, tuning.valve_lag_s, tuning.lead_filter_s)
        return self._command(self._fade_from_safe(leading, elapsed_s), elapsed_s)

    def _compute_current(self, speed: float, elapsed_s: float) -> float:
        """Return the current of map and trims [A], blended with the old ones while a change fades in."""
        current = self._current_with_trim(self.inverse, self._trims, speed)
        if self._before is None:
            return current
        self._share = self._advance_fade(self._share, elapsed_s)
        before = self._current_with_trim(*self._before, speed)
        if self._share == 1.0:
            self._before = None
        return before + self._share * (current - before)

    def _current_with_trim(self, inverse: InverseMap, trims: Sequence[float], speed: float) -> float:
        return inverse.current(speed, self._clip_to_reachable(inverse, speed)) + trims[speed > 0.0]

    def _clip_to_reachable(self, inverse: InverseMap, speed: float) -> float:
        """Return the desired force clipped to the steady forces at the current limits."""
        ends = inverse.force(speed, self.tuning.low_A), inverse.force(speed, self.tuning.high_A)
        return min(max(self.curve.at(speed), min(ends)), max(ends))

    def _learn(self, speed: float, force: float, elapsed_s: float) -> None:
        """Integrate the error once the force has built up, with anti-windup at the current limits."""
        self._stroke = speed * elapsed_s + (self._stroke if self._stroke * speed > 0.0 else 0.0)
        if not abs(force) < LARGEST_N:
            self.count.unfed += 1
            return
        if abs(self._stroke) < self.tuning.settle_m or self._before is not None:
            return
        side, tuning = int(speed > 0.0), self.tuning
        current = self.inverse.current(speed, self.reachable_N) + self._trims[side]
        slope = self.inverse.slope(speed, tuning.clip_current(current))
        scheduled = tuning.loop_gain_1_s * slope / (slope * slope + self._typical_slope**2)
        change = scheduled * (self.reachable_N - force) * elapsed_s
        if (current < tuning.high_A or change < 0.0) and (current > tuning.low_A or change > 0.0):
            span = tuning.high_A - tuning.low_A
            self._trims[side] = min(max(self._trims[side] + change, -span), span)

    def _fade_from_safe(self, requested: float, elapsed_s: float) -> float:
        """Fade from the safe current to the requested one within `recovery_s`."""
        if self._authority < 1.0:
            self._authority = self._advance_fade(self._authority, elapsed_s)
        return self.tuning.safe_A + self._authority * (requested - self.tuning.safe_A)

    def _advance_fade(self, share: float, elapsed_s: float) -> float:
        recovery = self.tuning.recovery_s
        return min(1.0, share + elapsed_s / recovery) if recovery > 0.0 else 1.0

    def _command(self, requested: float, elapsed_s: float) -> float:
        limited = self.tuning.clip_current(requested)
        last, reach = self.tuning.clip_current(self.command_A), self.tuning.rate_A_s * max(elapsed_s, 0.0)
        self.command_A = min(max(limited, last - reach), last + reach)
        if self.reason == OK:
            self.count.saturated += limited in (self.tuning.low_A, self.tuning.high_A)
            self.count.rate_limited += self.command_A != limited
        return self.command_A

    def _interrupt(self) -> None:
        self.desired_N = self.reachable_N = nan
        self._trims = [0.0, 0.0]
        self._before = None
        self._stroke = self._authority = 0.0
        self._speed_lead.reset()
        self._valve_lead.reset()


def _typical_slope(inverse: InverseMap) -> float:
    """Return the mean |dF/di| [N/A] over the map, at least 1, to which slopes are compared."""
    span = inverse.currents_A[-1] - inverse.currents_A[0]
    mean = sum(abs(row[-1] - row[0]) for row in inverse.forces_N) / (span * len(inverse.forces_N))
    return max(mean, 1.0)
