"""Clocks that drift apart: a force that is late by another time at the end of a recording than at its begin."""

from __future__ import annotations

import numpy as np

from ces_data.arrays import I
from ces_data.checks.delays import ROWS, DelayEstimate, as_delay, choose_rows, force_delay
from ces_data.checks.motion import (
    RATE_HZ,
    RecordedMotion,
    alternative_features,
    fit_errors,
    force_features,
    recorded_motion,
)
from ces_data.findings import WRONG_MODEL, Finding
from ces_data.limits import DelayLimits, DriftLimits
from ces_data.recording import Recording

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
    rows = _choose_moving_rows(motion)
    if len(rows) < DelayLimits.MIN_TICKS // 2 or motion.force.std() == 0.0:
        return None
    features, ticks = force_features(motion), np.arange(len(motion))
    features = np.concatenate([features, *alternative_features(motion).values()])[:, rows].T
    best = None
    for origin in (0.0, 0.5):
        late = np.outer(rows - origin * len(motion), rates)
        targets = np.interp(rows[:, None] + late, ticks, motion.force)
        drift = as_delay(rates, fit_errors(features, targets), DriftLimits.FACTOR, DelayLimits.FLOOR)
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


def _choose_moving_rows(motion: RecordedMotion) -> I:
    """Return ticks from the first motion to the last; none unless that is most of the time, and each third moves.

    Where the piston rests, nothing tells how late the force is.
    """
    rows, least = choose_rows(motion, round(DriftLimits.MAX_RATE * len(motion)), ROWS), DriftLimits.MIN_MOTION
    moving = np.flatnonzero(np.abs(motion.speed[rows]) > least * np.abs(motion.speed).max())
    rows = rows[moving[0] : moving[-1] + 1] if len(moving) else rows[:0]
    if len(rows) < 2 or rows[-1] - rows[0] < DriftLimits.MIN_MOVING * len(motion):
        return rows[:0]
    thirds = [float(np.sqrt(np.mean(part**2))) for part in np.array_split(motion.speed[rows], len(THIRDS))]
    return rows if min(thirds) > least * max(thirds) else rows[:0]


def _describe_drift(first_s: float, last_s: float) -> Finding:
    begin, end = (f"about {1e3 * abs(s):.0f} ms {'after' if s >= 0.0 else 'before'}" for s in (first_s, last_s))
    text = (
        f"force: logged {begin} the position at the begin and {end} it at the end: their clocks drift apart, which no "
        "constant delay corrects; log both with one clock, or rescale the stamps of one"
    )
    return Finding(WRONG_MODEL, text, "force")
