"""Faults that a sensor's own steps show: spikes and bursts, values lost for a while, counters that overflow; and drift.

A jump is a step far beyond the signal's usual ones. Position, force and current are judged each by itself. What is lost
in few samples is left out (`ces_data.samples`), here and in all programs; more would make a wrong model. Clocks that
drift apart make the force late by another time at the end of a recording than at its begin.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

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
from ces_data.checks.sensors import OTHER, REMEDY, count_times
from ces_data.findings import WARNING, WRONG_MODEL, Finding, runs_of_equal
from ces_data.limits import (
    DelayLimits,
    DriftLimits,
    JumpLimits,
    LossLimits,
    RecordingLimits,
    SensorLimits,
    StatisticLimits,
)
from ces_data.recording import Channel, Recording, Values
from ces_data.samples import find_jumps, find_spikes, mask_lost, without_spikes

FIT = "they are left out of the fit"
USE = {"position": FIT, "current": FIT, "force": "they are neither fitted nor scored"}
OVERFLOWS = "its counter or converter overflows: undo these jumps, or record with a larger range"


def split_spikes(recording: Recording) -> tuple[Recording, list[Finding]]:
    """Return the recording without spikes and dropouts, and the findings on these and on the jumps that are left."""
    lost = [f for name in LossLimits.JUMP_SPANS if name in recording.channels for f in _lost(name, recording)]
    clean = without_spikes(recording) if lost else recording
    jumps = [f for name in OTHER if name in clean.channels for f in _jumping(name, clean)]
    jumping = {f.signal for f in jumps}  # spikes of the same signal are short jumps
    return clean, [*jumps, *(f for f in lost if f.signal not in jumping)]


def _lost(name: str, recording: Recording) -> Iterator[Finding]:
    """Yield a finding on the spikes of a channel, and one on its dropouts."""
    channel = recording.channels[name]
    spikes = find_spikes(channel)
    lost = ~np.isfinite(mask_lost(recording, name).values) & np.isfinite(channel.values) & ~spikes
    if lost.any():
        spikes &= np.convolve(lost, np.ones(2 * JumpLimits.EDGE + 1), "same") < 0.5
    at = (channel.stamps_ns - channel.stamps_ns[:1]) * 1e-9
    if spikes.any():
        first = int(np.argmax(spikes))
        many = spikes.mean() > RecordingLimits.BAD_SHARE
        longest = max(b - a for a, b in runs_of_equal(spikes.astype(np.int64)) if spikes[a])
        what = "are spikes, or between two jumps" if many or longest > LossLimits.MAX_SPIKE else "are spikes"
        text = f"{name}: {int(spikes.sum())} of {len(channel)} samples {what}, first {channel.values[first]:.4g} "
        text += f"{channel.unit} at {at[first]:.3f} s; "
        text += (
            f"expected at most {RecordingLimits.BAD_SHARE:.0%}: check sensor and cable, and its range"
            if many
            else USE[name]
        )
        yield Finding(WRONG_MODEL if many else WARNING, text, name)
    if lost.any():
        begins = np.flatnonzero(np.diff(lost.astype(np.int8), prepend=0) == 1)
        wrong = lost.mean() > SensorLimits.WRONG_SHARE
        times = f"{count_times(len(begins))} {at[begins[0]]:.2f} s, {lost.mean():.1%} of the time"
        text = f"{name}: stuck {times}, and jumps; {REMEDY if wrong else USE[name]}"
        yield Finding(WRONG_MODEL if wrong else WARNING, text, name)


def _jumping(name: str, recording: Recording) -> Iterator[Finding]:
    """Yield a finding if a position or force jumps as its counter overflows, or a position as no piston moves."""
    sound = recording.channels[name].in_order()
    stamps, values = sound.stamps_ns, sound.values
    if len(values) < max(SensorLimits.MIN_SAMPLES, JumpLimits.MIN_DISTINCT * len(recording.channels[name])):
        return
    steps, intervals, period = np.diff(values), np.diff(stamps), float(np.ptp(values))
    jumps = find_jumps(values, LossLimits.JUMP_SPANS["position"] * float(np.ptp(np.percentile(values, (0.5, 99.5)))))
    jumps = jumps[intervals[jumps] <= RecordingLimits.GAP_INTERVALS * np.median(intervals)]
    whole = np.flatnonzero(np.abs(steps) > 0.5 * period)  # of a counter that overflows all the time
    candidates = [(jumps, float(np.median(np.abs(steps[jumps]))))] if len(jumps) > 1 else []
    candidates += [(whole, period)] if len(whole) >= JumpLimits.MIN_OVERFLOWS else []
    logged = _map_error(recording) if candidates else 0.0
    limit = logged if name == "position" else JumpLimits.BETTER * logged if logged > StatisticLimits.EXPLAINED else 0.0
    for at, size in candidates:
        undone = np.isin(np.arange(len(steps)), at) * np.sign(steps) * size
        unwrapped = np.cumsum(np.append(values[0], steps - undone))
        if limit == 0.0 or np.ptp(unwrapped) < JumpLimits.MIN_UNWRAPPED * size:
            continue  # the error is a damper's, or the signal flips
        if (
            _map_error(replace(recording, channels={**recording.channels, name: replace(sound, values=unwrapped)}))
            < limit
        ):
            yield Finding(WRONG_MODEL, f"{_describe(name, sound, at, size)}; {OVERFLOWS}", name)
            return
    often = len(whole) > JumpLimits.OFTEN * len(steps) and logged > JumpLimits.UNLIKE_FORCE
    if name == "force" and often and _is_against_motion(steps, whole):
        yield Finding(WRONG_MODEL, f"{_describe(name, sound, whole, 0.5 * period)} or more; {OVERFLOWS}", name)
    if (
        name == "position"
        and len(jumps)
        and np.median(np.abs(steps[jumps]) / intervals[jumps]) > 1e-9 * JumpLimits.PISTON_M_S
    ):
        size = float(np.median(np.abs(steps[jumps])))
        yield Finding(WRONG_MODEL, f"{_describe(name, sound, jumps, size)}, as no piston moves; {REMEDY}", name)


def _is_against_motion(steps: Values, jumps: I) -> bool:
    """Return whether most jumps go against the steps beside them: past its range, a counter begins at the other end.

    A force that is sampled too slowly jumps where it goes on in the same direction.
    """
    padded = np.concatenate([[0.0], steps, [0.0]])
    return float(np.mean(steps[jumps] * (padded[jumps] + padded[jumps + 2]) < 0.0)) > JumpLimits.AGAINST


def _describe(name: str, sound: Channel, jumps: I, size: float) -> str:
    times = f"{count_times(len(jumps))} {(sound.stamps_ns[jumps[0]] - sound.stamps_ns[0]) * 1e-9:.2f} s"
    return f"{name}: jumps by {size:.3g} {sound.unit} from one sample to the next {times}"


def _map_error(recording: Recording) -> float:
    """Return the relative error of a map from motion and current to the force; 1 if it is not known."""
    motion = recorded_motion(recording)
    if motion is None or motion.speed.std() == 0.0 or motion.force.std() == 0.0:
        return 1.0
    return float(fit_errors(force_features(motion).T, motion.force[:, None])[0])


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
