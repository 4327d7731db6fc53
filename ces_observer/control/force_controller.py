"""The reference controller: a desired force-speed curve in, a valve current out."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import exp, isfinite, nan

from ces_observer.control.inverse_map import InverseMap
from ces_observer.errors import CesError
from ces_observer.limits import ClockLimits, InverseLimits, NumberLimits
from ces_observer.records import quantity


class CurveError(CesError):
    """A desired speed-force curve that cannot be used."""


@dataclass(frozen=True)
class ForceCurve:
    """Piecewise linear force [N] over speed [m/s], both positive in compression; constant beyond its ends.

    A semi-active damper can only dissipate, so the force is at least 0 in compression and at most 0 in rebound. Raises
    CurveError for points that are not finite, not in order, or that would drive the motion.
    """

    speeds_m_s: tuple[float, ...]
    forces_N: tuple[float, ...]

    def __post_init__(self) -> None:
        speeds, forces = self.speeds_m_s, self.forces_N
        if len(speeds) != len(forces) or not 2 <= len(speeds) <= InverseLimits.MAX_POINTS:
            raise CurveError(
                f"curve: {len(speeds)} speeds and {len(forces)} forces; expected as many of each, 2 to "
                f"{InverseLimits.MAX_POINTS}"
            )
        if not all(map(isfinite, (*speeds, *forces))):
            raise CurveError("curve: a speed or force is not finite; give finite numbers in m/s and N")
        if any(right <= left for left, right in pairwise(speeds)):
            raise CurveError("curve: the speeds are not in rising order; sort the points by speed, each speed once")
        for speed, force in zip(speeds, forces, strict=True):
            if speed * force < 0.0:
                raise CurveError(
                    f"curve: {force:g} N at {speed:g} m/s would drive the motion; expected a force of the speed's sign"
                )
        at_rest = self.at(0.0)
        if speeds[0] < 0.0 < speeds[-1] and at_rest != 0.0:
            raise CurveError(f"curve: {at_rest:g} N at rest; expected 0: add a point at speed 0, force 0")

    @classmethod
    def from_points(cls, speeds_m_s: Sequence[float], forces_N: Sequence[float]) -> ForceCurve:
        """Return the curve through these points; raises CurveError."""
        return cls(tuple(map(float, speeds_m_s)), tuple(map(float, forces_N)))

    def at(self, speed_m_s: float) -> float:
        """Return the desired force [N] at a finite speed [m/s]."""
        speeds, forces = self.speeds_m_s, self.forces_N
        right = bisect_right(speeds, speed_m_s)
        if right == 0:
            return forces[0]
        if right == len(speeds):
            return forces[-1]
        share = (speed_m_s - speeds[right - 1]) / (speeds[right] - speeds[right - 1])
        return forces[right - 1] + share * (forces[right] - forces[right - 1])


class Lead:
    """(1 + zero_s s) / (1 + filter_s s) for unevenly spaced samples; the first one after `reset` passes unchanged.

    With `zero_s` at or below `filter_s` all samples pass unchanged.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._filtered: float | None = None

    def step(self, value: float, elapsed_s: float, zero_s: float, filter_s: float) -> float:
        """Return the signal with its lead, `elapsed_s` after the last value."""
        if self._filtered is None or zero_s <= filter_s or elapsed_s <= 0.0:
            self._filtered = value
            return value
        behind = value - self._filtered
        self._filtered = value - behind * exp(-elapsed_s / filter_s) if filter_s > 0.0 else value
        return value + behind * (zero_s - filter_s) / max(filter_s, elapsed_s)


@dataclass(frozen=True)
class Tuning:
    """Settings of a ForceController, which explains them; raises CesError for values that cannot be used."""

    low_A: float = quantity(0.29, "A", "lowest current to command", 0.0, InverseLimits.MAX_CURRENT_A)
    high_A: float = quantity(0.70, "A", "highest current to command", 0.0, InverseLimits.MAX_CURRENT_A)
    safe_A: float = quantity(
        0.40, "A", "current without a usable estimate, within the limits", 0.0, InverseLimits.MAX_CURRENT_A
    )
    rate_A_s: float = quantity(100.0, "A/s", "fastest change of the command", 0.01, 1e6)
    timeout_s: float = quantity(
        0.05, "s", "time without estimates after which the safe current is commanded", 0.005, 10.0
    )
    loop_gain_1_s: float = quantity(4.0, "1/s", "gain of the feedback; 0: feed-forward alone", 0.0, 100.0)
    settle_m: float = quantity(0.003, "m", "stroke after a reversal from which the force is fed back", 0.0, 1.0)
    valve_lag_s: float = quantity(
        0.008,
        "s",
        "lag of the force behind the current that the command's lead compensates; 0: no lead; "
        "negative: the model's lag minus preview_s",
        0.0,
        0.2,
    )
    preview_s: float = quantity(0.006, "s", "time by which the feed-forward predicts the speed", 0.0, 0.05)
    lead_filter_s: float = quantity(0.003, "s", "time constant of the filters of lead and preview", 0.0, 0.1)
    recovery_s: float = quantity(0.2, "s", "time of fading in after an interruption", 0.0, 60.0)

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not isfinite(value):
                raise CesError(f"{name} is {value}; expected a finite number")
            if value < 0.0 and name not in ("low_A", "high_A", "safe_A"):
                raise CesError(f"{name} is {value:g}; expected at least 0")
        if not self.low_A < self.high_A:
            raise CesError(f"low_A is {self.low_A:g} and high_A {self.high_A:g}; expected the lower limit first")
        if not self.low_A <= self.safe_A <= self.high_A:
            raise CesError(f"safe_A is {self.safe_A:g}; expected it within {self.low_A:g} to {self.high_A:g} A")
        if self.rate_A_s == 0.0 or self.timeout_s == 0.0:
            raise CesError("rate_A_s or timeout_s is 0; expected numbers above 0")

    @staticmethod
    def lead_s(model_lag_s: float, preview_s: float) -> float:
        """Return the `valve_lag_s` [s] for a model with this lag of force behind current: the lag minus the preview.

        A lead by the whole lag gains little: the limits clip it unevenly, which shifts the mean current.
        """
        return max(model_lag_s - preview_s, 0.0)

    def clip_current(self, current_A: float) -> float:
        """Return the current [A] within the limits."""
        return min(max(current_A, self.low_A), self.high_A)


OK = "ok"
NO_ESTIMATE = "no estimates arrive"
STALE = "the estimate is stale"
NOT_FINITE = "the estimate is not finite"


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

        A stamp that repeats, or runs back by less than a jump of the clock, changes nothing; after a gap longer than
        `timeout_s`, or a jump, the controller restarts.
        """
        elapsed_ns = -ClockLimits.JUMP_NS if self._stamp_ns is None else stamp_ns - self._stamp_ns
        if -ClockLimits.JUMP_NS < elapsed_ns <= 0:
            return self.command_A
        self._stamp_ns = stamp_ns
        elapsed_s = elapsed_ns * 1e-9 if elapsed_ns > 0 else 0.0
        if not abs(speed_m_s) < NumberLimits.MAX_INPUT:
            return self.fail_safe(NOT_FINITE, min(elapsed_s, self.tuning.timeout_s))
        if elapsed_s == 0.0 or elapsed_s > self.tuning.timeout_s:
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
        if self._authority < 1.0:
            self._authority = self._advance_fade(self._authority, elapsed_s)
        return self._command(tuning.safe_A + self._authority * (leading - tuning.safe_A), elapsed_s)

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
        if not abs(force) < NumberLimits.MAX_NUMBER:
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
