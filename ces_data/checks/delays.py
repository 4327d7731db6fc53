"""Delays between channels, estimated with an interval: how late force or current are logged relative to the position.

A damper's force depends on motion and current until now, never on those to come. For every shift of a channel, a
flexible causal map of position, speed and current, with memory, is fitted to the force by least squares; it contains
the lags that dampers have. The relative error of the fit is least at the right shift. All shifts that fit almost as
well form the interval: where a lag of the damper or of its valve could imitate the delay, as with a single sine, the
interval is wide and holds zero. A delay is claimed only beside inertia, forces of position, and slow valves.

Recordings of one damper by one logger may be joined: sines at several frequencies show together what none shows alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ces_data.arrays import F, I
from ces_data.checks.motion import (
    INERTIA,
    LAGS_S,
    RATE_HZ,
    SLOW_VALVE,
    SPRING,
    VALVE_LAGS_S,
    RecordedMotion,
    alternative_features,
    fit_errors,
    force_features,
    hats,
    is_constant,
    lag,
    moved_mass,
    normalize,
    recorded_motion,
)
from ces_data.findings import WARNING, WRONG_MODEL, DelayFinding, Finding
from ces_data.limits import DelayLimits, DriftLimits, SignLimits, StatisticLimits
from ces_data.recording import Recording

ROWS, CURRENT_ROWS = 8000, 5000  # of the regressions
CURRENT_KNOTS = (0.0, 0.03, 0.2, 0.4, 0.6, 0.8, 0.97, 1.0)
CURRENT_STEP = 2  # ticks between shifts of the current


@dataclass(frozen=True)
class DelayEstimate:
    """How late a signal is [s], the interval of shifts (up to `reach_s`) that fit, and the errors at zero and best.

    `alternatives` name what explains the force as well without a delay; the interval is that of a fit without them.
    """

    late_s: float
    low_s: float
    high_s: float
    error_at_zero: float
    least_error: float
    reach_s: float = DelayLimits.MAX_S
    alternatives: tuple[str, ...] = ()

    @property
    def certain(self) -> bool:
        """Whether the interval does not hold zero."""
        return self.low_s > 0.0 or self.high_s < 0.0

    @property
    def likely(self) -> bool:
        """Whether a delay beyond the lags of dampers fits clearly better than none; none cannot be excluded."""
        limit = max(
            DelayLimits.LIKELY_FACTOR * self.least_error, float(np.hypot(self.least_error, DelayLimits.LIKELY_FLOOR))
        )
        narrow = self.high_s - self.low_s < DelayLimits.LIKELY_WIDTH_S  # a single fast sine fits at any phase
        return (
            narrow
            and abs(self.late_s) > DelayLimits.LIKELY_S
            and self.least_error < StatisticLimits.EXPLAINED
            and self.error_at_zero > limit
        )

    @property
    def open_ended(self) -> bool:
        """Whether the largest shift that was tried fits, too, so that the delay may be larger."""
        return max(-self.low_s, self.high_s) >= self.reach_s - 1.0 / RATE_HZ

    @property
    def beyond(self) -> bool:
        """Whether the largest shift that was tried fits best: the delay is at least that of the interval's near end."""
        return abs(self.late_s) >= self.reach_s - 1.0 / RATE_HZ

    @property
    def nearest_s(self) -> float:
        """The end of the interval that is nearer to zero, 0 if zero is inside."""
        return min((self.low_s, self.high_s), key=abs) if self.certain else 0.0


def force_delay(motion: RecordedMotion, far: bool = True) -> DelayEstimate | None:
    """Return how late the force is after the position, None if unknown; `far`: beyond MAX_S if none fits."""
    if len(motion) < DelayLimits.MIN_TICKS or motion.speed.std() == 0.0 or motion.force.std() == 0.0:
        return None
    near = _force_delay_within(motion, DelayLimits.MAX_S)
    settled = (
        near is not None and not near.open_ended and not near.certain and near.least_error < StatisticLimits.EXPLAINED
    )
    if not far or settled:
        return near
    wide = _force_delay_within(motion, DelayLimits.FAR_S)
    if (
        wide is None
        or wide.open_ended
        or wide.least_error > StatisticLimits.EXPLAINED
        or abs(wide.late_s) <= DelayLimits.MAX_S
    ):
        return near
    return wide if near is None or DelayLimits.FACTOR * wide.least_error < near.least_error else near


def _force_delay_within(motion: RecordedMotion, reach_s: float) -> DelayEstimate | None:
    """Return the delay if one of up to `reach_s` fits, and the parts of the motion are long enough for such shifts."""
    features, reach = force_features(motion), round(reach_s * RATE_HZ)
    rows = _rows(motion, reach, ROWS)
    if len(rows) < DelayLimits.MIN_TICKS // 2:
        return None
    shifts = np.arange(-reach, reach + 1)
    targets = np.stack([motion.force[rows + shift] for shift in shifts], axis=1)

    def estimate(*more: F) -> DelayEstimate | None:
        errors = fit_errors(np.concatenate([features, *more])[:, rows].T, targets)
        return _as_delay(shifts / RATE_HZ, errors, DelayLimits.FACTOR, DelayLimits.FLOOR)

    return _with_alternatives(motion, estimate)


def current_delay(motion: RecordedMotion, force_late_s: float = 0.0) -> DelayEstimate | None:
    """Return how late the current is after the force, which is `force_late_s` after the position; None if unknown."""
    if len(motion) < DelayLimits.MIN_TICKS or is_constant(motion.current) or motion.speed.std() == 0.0:
        return None
    reach, late = round(DelayLimits.MAX_S * RATE_HZ), round(force_late_s * RATE_HZ)
    rows = _rows(motion, reach + abs(late), CURRENT_ROWS)
    speeds, n = hats(motion.speed, CURRENT_KNOTS), normalize(motion.current)
    alone = np.concatenate([speeds, lag(speeds, LAGS_S[1]), normalize(motion.position)[None]])[:, rows]
    currents = [*(lag(n, seconds) for seconds in VALVE_LAGS_S), n**2, lag(n**2, VALVE_LAGS_S[1])]
    if fit_errors(alone.T, n[rows][:, None])[0] < DelayLimits.MAX_WITHOUT_CURRENT:
        return None
    target = motion.force[rows + late][:, None]
    shifts = np.arange(-reach, reach + 1, CURRENT_STEP)

    def estimate(*more: F) -> DelayEstimate | None:
        errors = []
        for shift in shifts:
            moved = (speeds[:, rows] * c[rows + late + shift] for c in currents)
            features = np.concatenate([alone, *(one[:, rows] for one in more), *moved])
            errors.append(fit_errors(features.T, target)[0])
        return _as_delay(shifts / RATE_HZ, np.array(errors), DelayLimits.CURRENT_FACTOR, DelayLimits.CURRENT_FLOOR)

    return _with_alternatives(motion, estimate)


def _with_alternatives(motion: RecordedMotion, estimate: Callable[..., DelayEstimate | None]) -> DelayEstimate | None:
    """Return the estimate with what else fits: the wider interval, no delay if that fits better, or `alternatives`."""
    alone = estimate()
    if alone is None or not (alone.certain or alone.likely):
        return alone
    features = alternative_features(motion)
    beside = estimate(*features.values())
    if beside is None:
        return alone
    if beside.certain and beside.late_s * alone.late_s > 0.0:
        return replace(alone, low_s=min(alone.low_s, beside.low_s), high_s=max(alone.high_s, beside.high_s))
    if not beside.likely and beside.error_at_zero < alone.least_error:
        return beside
    names = [name for name, rows in features.items() if (e := estimate(rows)) is not None and not e.certain]
    return replace(alone, alternatives=tuple(names or features))


def _rows(motion: RecordedMotion, margin: int, most: int) -> I:
    """Return at most `most` ticks, evenly spread, that stay inside when shifted by `margin`."""
    inside = motion.inner_ticks(margin + round(0.05 * RATE_HZ), margin)
    return inside if len(inside) <= most else inside[np.linspace(0, len(inside) - 1, most).astype(np.int64)]


def _as_delay(shifts_s: F, errors: F, factor: float, floor: float) -> DelayEstimate | None:
    best = int(np.argmin(errors))
    if errors[best] > DelayLimits.MAX_ERROR:
        return None
    limit = max(factor * float(errors[best]), float(np.hypot(errors[best], floor)))
    low, high = (_crossing(shifts_s, errors, limit, best, step) for step in (-1, 1))
    at_zero = float(errors[len(errors) // 2])
    return DelayEstimate(_vertex(shifts_s, errors, best), low, high, at_zero, float(errors[best]), float(shifts_s[-1]))


def _crossing(shifts_s: F, errors: F, limit: float, best: int, step: int) -> float:
    """Return the outermost shift on one side of the best whose error is within the limit, interpolated."""
    side = np.arange(best, len(errors) if step > 0 else -1, step)
    last = int(side[np.flatnonzero(errors[side] <= limit)[-1]])
    beyond = last + step
    if not 0 <= beyond < len(errors):
        return float(shifts_s[last])
    share = (limit - errors[last]) / (errors[beyond] - errors[last])
    return float(shifts_s[last] + share * (shifts_s[beyond] - shifts_s[last]))


def _vertex(shifts_s: F, errors: F, best: int) -> float:
    """Return the shift at the vertex of the parabola through the squared errors beside the best."""
    if best in (0, len(errors) - 1):
        return float(shifts_s[best])
    left, middle, right = errors[best - 1 : best + 2] ** 2
    curvature = left - 2.0 * middle + right
    offset = 0.0 if curvature <= 0.0 else 0.5 * (left - right) / curvature
    return float(shifts_s[best] + offset * (shifts_s[1] - shifts_s[0]))


BLOCK_TICKS = 500


def dissipation(motion: RecordedMotion, late_s: float = 0.0) -> tuple[float, float]:
    """Return the dissipated over the exchanged power (-1 to 1), and the share of blocks that return energy.

    A damper dissipates on balance, whatever its spring, friction or lag. `late_s` is the delay of the force.
    """
    shift = round(late_s * RATE_HZ)
    force = motion.force - motion.force.mean()
    power = np.roll(force, -shift) * motion.speed
    power = power[max(0, -shift) : len(power) - max(0, shift)]
    blocks = np.array_split(power, max(1, len(power) // BLOCK_TICKS))
    size = np.array([np.abs(block).sum() for block in blocks])
    returned = np.array([block.sum() < 0.0 for block in blocks])
    total = float(size.sum())
    return (float(power.sum()) / total, float(size[returned].sum()) / total) if total > 0.0 else (0.0, 0.0)


def is_reversed(motion: RecordedMotion, delay: DelayEstimate | None) -> bool:
    """Return whether the recorded force drives the piston on balance: its sign or that of the position is wrong.

    A force that is late by half a stroke does so, too: of an unknown delay, nothing follows.
    """
    if delay is not None and delay.certain and delay.beyond:
        return False
    late = delay.late_s if delay is not None and delay.certain else 0.0
    balance, returned = dissipation(motion, late)
    return balance < -SignLimits.MIN_WORK and returned > SignLimits.MIN_BLOCKS


def sign_findings(motion: RecordedMotion, delay: DelayEstimate | None = None) -> Iterator[Finding]:
    """Yield a finding if the force, moved back by its delay, drives the piston."""
    if is_reversed(motion, delay):
        text = (
            "force: acts with the motion instead of against it, and no damper gives energy; position and force are "
            "positive in compression: multiply the scale of the one that is not by -1 in the signals file (if both "
            "are, one is late by half a stroke: align their clocks)"
        )
        yield Finding(WRONG_MODEL, text, "force")


def delay_findings(motion: RecordedMotion, force: DelayEstimate | None) -> Iterator[Finding]:
    """Yield the delay of force or position, and that of the current if it fits neither of the two."""
    moved = _current_instead(motion, force) if force is not None and (force.certain or force.likely) else None
    if moved is not None:
        yield from _describe("current", "force", moved, motion)
        return
    if force is not None:
        yield from _describe("force", "position", force, motion)
    offset = force.late_s if force is not None and force.certain else 0.0
    if abs(offset) > 0.5 * DelayLimits.MAX_S:  # the shifts that are tried do not reach the position's time
        return
    current = current_delay(motion, offset)
    if current is not None and current.certain and not current.low_s <= -offset <= current.high_s:
        yield from _describe("current", "force", current, motion)  # not in line with the position instead


def _describe(signal: str, other: str, delay: DelayEstimate, motion: RecordedMotion) -> Iterator[Finding]:
    if abs(delay.nearest_s) >= DelayLimits.MIN_S:
        yield _describe_delay(signal, other, delay, motion)
    elif delay.likely and not delay.alternatives:
        yield _describe_likely(signal, other, delay)


def _current_instead(motion: RecordedMotion, force: DelayEstimate) -> DelayEstimate | None:
    """Return the delay of the current if it explains the force at least as well as `force`, that of the force, does."""
    current = current_delay(motion)
    if current is None or abs(current.late_s) < DelayLimits.MIN_S:
        return None
    again = force_delay(replace(motion, current=np.roll(motion.current, -round(current.late_s * RATE_HZ))))
    in_line = again is not None and abs(again.nearest_s) < DelayLimits.MIN_S and not again.likely
    return current if again is not None and in_line and again.error_at_zero <= force.least_error else None


LOOK_ALIKES = {  # text by alternative
    INERTIA: "a mass of about {kg:.0f} kg between piston and load cell",
    SPRING: "a gas spring or a damping that depends on position",
    SLOW_VALVE: "a slow valve",
}


def _describe_delay(signal: str, other: str, delay: DelayEstimate, motion: RecordedMotion) -> DelayFinding:
    near, far = sorted(1e3 * abs(s) for s in (delay.low_s, delay.high_s))
    name, relation, key_s = _name_late(signal, other, delay.late_s)
    key = f"the key delay (default 0) of {name} in the signals file"
    interval = f"{near:.0f} ms or more" if delay.open_ended else f"{near:.0f} to {far:.0f}"
    text = f"{1e3 * abs(delay.late_s):.0f} ms ({interval}) {relation}; add {key_s:.3f} to {key}"
    if delay.beyond:
        unknown = "too much to estimate; compare how both are stamped, set"
        text = f"at least {near:.0f} ms {relation}, {unknown} {key}, and check again"
    if delay.alternatives:
        others = " or ".join(LOOK_ALIKES[effect] for effect in delay.alternatives).format(kg=moved_mass(motion))
        text = f"{1e3 * abs(delay.late_s):.0f} ms {relation}, or {others}: these recordings cannot tell; compare how "
        return DelayFinding(WARNING, f"{name}: {text}both are stamped, and set {key} if it is late", name)
    sure = signal != "current" and abs(delay.nearest_s) >= DelayLimits.WRONG_S  # a slow valve, or a bypass, looks alike
    return DelayFinding(WRONG_MODEL if sure else WARNING, f"{name}: logged {text}", name)


def _describe_likely(signal: str, other: str, delay: DelayEstimate) -> DelayFinding:
    """Return a warning: the delay fits best, but the elasticity of the damper, or its valve, may be what is seen."""
    low, high = sorted(np.sign(delay.late_s) * 1e3 * s for s in (delay.low_s, delay.high_s))
    name, relation, _ = _name_late(signal, other, delay.late_s)
    cause = "valve" if signal == "current" else "elasticity"
    text = (
        f"{name}: perhaps logged {1e3 * abs(delay.late_s):.0f} ms {relation}; {low:.0f} to {high:.0f} ms fit, too, as "
        f"a damper's {cause} does on these strokes: check with faster and more varied ones, or set the key delay "
        f"(default 0) of {name} in the signals file"
    )
    return DelayFinding(WARNING, text, name)


def _name_late(signal: str, other: str, late_s: float) -> tuple[str, str, float]:
    """Return the signal to correct, its relation to the other, and what to add to its key [s].

    Of force and position it is the late one. The current is corrected itself, also if it is early: the force is in line
    with the position.
    """
    if signal == "current" and late_s < 0.0:
        return signal, f"before the {other}", late_s
    late, reference = (signal, other) if late_s > 0.0 else (other, signal)
    return late, f"after the {reference}", abs(late_s)


THIRDS = ((0.0, 1.0 / 3.0), (1.0 / 3.0, 2.0 / 3.0), (2.0 / 3.0, 1.0))  # of the position's samples


def find_clock_drift(recording: Recording) -> Finding | None:
    """Return a finding if the force is late by another time at the end of the recording than at its begin.

    The middle must lie between: on a stroke that repeats, a delay is known but for a whole period.
    """
    delays = []
    for part in THIRDS:
        motion = recorded_motion(recording.share(*part))
        delay = None if motion is None else force_delay(motion, far=False)
        if delay is None or delay.alternatives:
            return None
        delays.append(delay)
    first, middle, last = delays
    # more than what the damper's elasticity, which is in both, leaves open
    change, width = last.late_s - first.late_s, max(delay.high_s - delay.low_s for delay in (first, last))
    if first.beyond or last.beyond or abs(change) <= max(DriftLimits.MIN_CHANGE_S, DriftLimits.CLEARLY * width):
        return None
    if abs(middle.late_s - 0.5 * (first.late_s + last.late_s)) > DriftLimits.STEADY * abs(change):
        return None
    return _describe_drift(first.late_s, last.late_s)


DRIFT_STEPS = 41  # of the rates that are tried on each side


def find_drift_within(motion: RecordedMotion, delay: DelayEstimate | None = None) -> Finding | None:
    """Return a finding if the force fits clearly better at a delay that grows with time than at none and at `delay`."""
    seconds = len(motion) / RATE_HZ
    rates = np.linspace(-DriftLimits.MAX_RATE, DriftLimits.MAX_RATE, 2 * DRIFT_STEPS + 1)
    rows = _rows(motion, round(DriftLimits.MAX_RATE * seconds * RATE_HZ), ROWS)
    if len(rows) < DelayLimits.MIN_TICKS // 2 or motion.force.std() == 0.0 or not _moves_throughout(motion.speed[rows]):
        return None
    features, ticks = force_features(motion), np.arange(len(motion))
    features = np.concatenate([features, *alternative_features(motion).values()])[:, rows].T
    best = None
    for origin in (0.0, 0.5):
        late = np.outer(rows - origin * len(motion), rates)
        targets = np.interp(rows[:, None] + late, ticks, motion.force)
        drift = _as_delay(rates, fit_errors(features, targets), DriftLimits.FACTOR, DelayLimits.FLOOR)
        if drift is not None and (best is None or drift.least_error < best[1].least_error):
            best = origin, drift
    if best is None or not best[1].certain or best[1].least_error > DriftLimits.MAX_ERROR:
        return None
    if delay is not None and DriftLimits.FACTOR * best[1].least_error > delay.least_error:
        return None
    change = best[1].late_s * seconds
    return (
        _describe_drift(-best[0] * change, (1.0 - best[0]) * change) if abs(change) > DriftLimits.MIN_CHANGE_S else None
    )


def _moves_throughout(speed: F) -> bool:
    """Return whether each third of the time moves: where the piston rests, nothing tells how late the force is."""
    thirds = [float(np.sqrt(np.mean(part**2))) for part in np.array_split(speed, len(THIRDS))]
    return min(thirds) > DriftLimits.MIN_MOTION * max(thirds)


def _describe_drift(first_s: float, last_s: float) -> Finding:
    begin, end = (f"about {1e3 * abs(s):.0f} ms {'after' if s >= 0.0 else 'before'}" for s in (first_s, last_s))
    text = (
        f"force: logged {begin} the position at the begin and {end} it at the end: their clocks drift apart, which no "
        "constant delay corrects; log both with one clock, or rescale the stamps of one"
    )
    return Finding(WRONG_MODEL, text, "force")
