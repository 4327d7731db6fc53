"""The force controller: speed and estimated force in, valve current out, so that the damper's force follows a curve.

    desired  = curve(speed), clipped to what the current limits reach there       (counted: a damper only dissipates)
    ahead    = inverse map(speed to be in preview_s, the force desired then)      (feed-forward)
    trim'    = loop_gain * slope / (slope^2 + typical^2) * (desired - force)      (feedback; slope = dF/di)
    command  = ahead + trim, with a lead against the valve's lag; then the current limits and the rate limit

**Feed-forward** does the fast part. What it has to beat is time: transport, the filters, and the valve, whose force
follows the current only after several milliseconds. `preview_s` looks ahead of the speed, and the lead
(1 + valve_lag s) / (1 + lead_filter s) makes up for the rest of the lag, as far as the limits let it; both amplify
noise by about their ratio to `lead_filter_s`.

**Feedback** does the slow part: it learns what the map has wrong, as a trim of the current for compression and one for
rebound, since an error in one says nothing about the other. No feedback is fast enough to follow the stroke itself:
with a valve that lags by 10 ms the loop ends where road and wheel only begin. After a reversal oil and bushing give
way before the force can build up, whatever the current; an error there is none of the map's and would drive the trim
astray, so that the force counts only from `settle_m` of stroke on. dF/di carries the sign (negative in rebound) and
schedules the gain: the loop gain times slope^2 / (slope^2 + typical^2) [1/s], much the same at all speeds where the
current has its say, never more than `loop_gain_1_s`, next to nothing near standstill.

**Margin.** Seen from the trim, the force is slope / (1 + lag s), behind a delay T of transport and estimation. With
nothing gained by the lead the open loop is L(s) = g / s * exp(-T s) / (1 + lag s), g <= loop_gain. Its phase margin is
at least 90 deg - 57.3 deg * g (T + lag), its gain margin at least 1 / (g (T + lag)). The defaults give 86 deg and 16
at lag = 10 ms, T = 5 ms; slopes wrong by a factor of 3 and a valve five times as slow together leave 52 deg and 1.5.
Hysteresis of the valve shifts the current by a bounded amount, which a trim learns as the stroke goes to and fro.

The current is the safe one when the estimate stops, is stale or is not finite, reached at the rate limit. Afterwards
the controller takes over gradually within `recovery_s`, from the safe current and with its trims at zero.
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
JUMP_NS = 1_000_000_000  # a stamp this much earlier than the last one means that the clock was set back
FASTEST_M_S = 1e6  # a speed beyond is no speed; far from where sums overflow
LARGEST_N = 1e9  # as of a model's force envelope


@dataclass
class ControllerCounts:
    """Counts since the start: steps that followed the curve, how many of them ..., and interruptions by reason."""

    steps: int = 0
    unreachable: int = 0  # desired force outside what the damper can do at this speed
    saturated: int = 0  # command at a current limit
    rate_limited: int = 0
    unfed: int = 0  # without a usable force to feed back
    interruptions: dict[str, int] = field(default_factory=dict)


class ForceController:
    """One damper's controller.

    After `step`: `command_A` is the current to command, `desired_N` the curve's force, `reachable_N` that clipped to
    what the damper can do (both NaN while the safe current is commanded), `reason` "ok" or why it is. Every command is
    finite, within the limits and no further from the one before than the rate limit allows.
    """

    def __init__(self, curve: ForceCurve, inverse: InverseMap, tuning: Tuning) -> None:
        self.curve = curve
        self.inverse = inverse
        self.tuning = tuning
        self.count = ControllerCounts()
        self.command_A = tuning.safe_A
        self._typical_slope = _typical_slope(inverse)
        self._before: tuple[InverseMap, Sequence[float]] | None = None  # map and trims that fade out
        self._share = 0.0  # 0 to 1: of the way from them
        self._speed_lead, self._valve_lead = Lead(), Lead()
        self._trims = [0.0, 0.0]  # [A] in rebound, in compression
        self._stroke = 0.0  # [m] since the last reversal
        self._authority = 0.0  # 0 to 1: share of the way from the safe current
        self.reset()

    def reset(self) -> None:
        """Bring the controller back to new, but for its last command and its counts."""
        self.reason = NO_ESTIMATE
        self._stamp_ns: int | None = None
        self._interrupt()

    @property
    def trims_A(self) -> tuple[float, float]:
        """What feedback adds to the map's current [A] in rebound and in compression."""
        return self._trims[0], self._trims[1]

    def adopt(self, inverse: InverseMap) -> None:
        """Feed `inverse` forward from now on: it fades in within `recovery_s`, from what the map before commands.

        The trims begin at zero: what they held was wrong with the map before. They are not learned meanwhile.
        """
        self._before, self._share = (self.inverse, self._trims), 0.0
        self.inverse, self._typical_slope = inverse, _typical_slope(inverse)
        self._trims = [0.0, 0.0]

    def step(self, stamp_ns: int, speed_m_s: float, force_N: float) -> float:
        """Return the current [A] for an estimate of this stamp; a force that is not finite is not fed back.

        A stamp that repeats, or runs back by less than JUMP_NS, changes nothing; after a gap longer than `max_gap_s`,
        or a jump back, the controller takes over anew.
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
        wanted = tuning.clip_current(self._compute_current(soon, elapsed_s))
        leading = self._valve_lead.step(wanted, elapsed_s, tuning.valve_lag_s, tuning.lead_filter_s)
        return self._command(self._fade_from_safe(leading, elapsed_s), elapsed_s)

    def _compute_current(self, speed: float, elapsed_s: float) -> float:
        """Return the current of map and trims [A], on the way to it from those before if they were changed."""
        wanted = self._current_with_trim(self.inverse, self._trims, speed)
        if self._before is None:
            return wanted
        self._share = self._advance_fade(self._share, elapsed_s)
        before = self._current_with_trim(*self._before, speed)
        if self._share == 1.0:
            self._before = None
        return before + self._share * (wanted - before)

    def _current_with_trim(self, inverse: InverseMap, trims: Sequence[float], speed: float) -> float:
        return inverse.current(speed, self._clip_to_reachable(inverse, speed)) + trims[speed > 0.0]

    def _clip_to_reachable(self, inverse: InverseMap, speed: float) -> float:
        """Return the desired force as near as the steady force at the current limits comes to it."""
        ends = inverse.force(speed, self.tuning.low_A), inverse.force(speed, self.tuning.high_A)
        return min(max(self.curve.at(speed), min(ends)), max(ends))

    def _learn(self, speed: float, force: float, elapsed_s: float) -> None:
        """Integrate the error once the force has built up, unless it asks for more than a limit that is reached."""
        self._stroke = speed * elapsed_s + (self._stroke if self._stroke * speed > 0.0 else 0.0)
        if not abs(force) < LARGEST_N:
            self.count.unfed += 1
            return
        if abs(self._stroke) < self.tuning.settle_m or self._before is not None:
            return
        side, tuning = int(speed > 0.0), self.tuning
        wanted = self.inverse.current(speed, self.reachable_N) + self._trims[side]
        slope = self.inverse.slope(speed, tuning.clip_current(wanted))
        scheduled = tuning.loop_gain_1_s * slope / (slope * slope + self._typical_slope**2)
        change = scheduled * (self.reachable_N - force) * elapsed_s
        if (wanted < tuning.high_A or change < 0.0) and (wanted > tuning.low_A or change > 0.0):
            span = tuning.high_A - tuning.low_A
            self._trims[side] = min(max(self._trims[side] + change, -span), span)

    def _fade_from_safe(self, requested: float, elapsed_s: float) -> float:
        """Fade from the safe current to the wanted one within `recovery_s`."""
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
    """Return the mean |dF/di| [N/A] over the map, at least 1: what a slope has to beat to have its say."""
    span = inverse.currents_A[-1] - inverse.currents_A[0]
    mean = sum(abs(row[-1] - row[0]) for row in inverse.forces_N) / (span * len(inverse.forces_N))
    return max(mean, 1.0)
