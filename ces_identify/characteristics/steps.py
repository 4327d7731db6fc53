"""The response of the valve: how the force follows a step of the current while the piston moves at a constant speed.

The force is normalised to 0 before the step and 1 after it. Read are the times from the step to 28.3, 63.2 and 90 %,
and from 10 % to 90 %. A first-order lag with a dead time that passes through the first two has the time constant
1.5 (t63 - t28) and the dead time t63 - 1.5 (t63 - t28) (Smith, 1972). The step counts from a share of the change of the
logged current, so the lag of the coil belongs to the response only if the command was logged. Everything between valve
and load cell (oil, bushing) belongs to it, too. A dip that recovers is not taken for the response: a share of the
change counts where the force stays beyond it. Overshoot and settling are those of the mean response, where noise is
least.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d
from scipy.signal import savgol_filter
from scipy.stats import t as student

from ces_data.arrays import F
from ces_identify.characteristics.cycles import COMPRESSION, REBOUND, group_values
from ces_identify.characteristics.motion import MEASURED, RecordingMotion, Stretch
from ces_identify.characteristics.rows import ResponsePoint, StepResponse, ValveResponse
from ces_identify.characteristics.rules import BenchRules
from ces_identify.limits import DynoLimits, ErrorLimits, StepLimits, TickLimits

TRACE_STEP_S = 0.0005
TRACE_S = np.round(np.arange(-0.020, 0.1001, TRACE_STEP_S), 4)  # [s] from the step, where the mean response is shown
NO_STEP, DIP = "the force does not follow", "it dips and recovers"
NOT_SEEN = "no force from this source around the step"
SINCE_STEP = ("time_63_s", "time_90_s", "dead_time_s")
TIMES = (*SINCE_STEP, "time_constant_s", "rise_s")
HARDER, SOFTER = "soft to hard", "hard to soft"
SMOOTH_POINTS = 11  # of the mean response, 5.5 ms, through which a parabola goes


@dataclass(frozen=True)
class CurrentStep:
    """A step of the current in a stretch: sample `at` is the first with the changed current.

    `time_s` is the middle of the interval of length 2 * `time_doubt_s` in which the change began.
    """

    at: int
    time_s: float
    time_doubt_s: float
    from_A: float
    to_A: float


@dataclass(frozen=True)
class ReadStep:
    """A row of the table of steps and the normalised force at TRACE_S, NaN after a change; None if it was not read.

    `noise` is the RMS of the noise, as a share of the change, behind a parabola through SMOOTH_POINTS of the trace;
    `lasts_s` is how long the step is read.
    """

    row: StepResponse
    trace: F | None = None
    noise: float = np.nan
    lasts_s: float = np.nan


def read_steps(
    motion: RecordingMotion, sources: Sequence[str], tolerance_A: float, rules: BenchRules
) -> Iterator[ReadStep]:
    """Yield every step of the current as each source responds to it."""
    for stretch in motion.stretches:
        for step in find_steps(stretch, tolerance_A, rules.step_start):
            key = {"recording": motion.name, **{name: value for name, value in vars(step).items() if name != "at"}}
            for source in sources:
                response = time_step(stretch, step, stretch.forces[source], motion.force_noise_N, rules)
                if isinstance(response, str):
                    yield ReadStep(StepResponse(source=source, **key, note=response))
                else:
                    yield replace(response, row=replace(response.row, source=source, **key))


def find_steps(stretch: Stretch, tolerance_A: float, start: float) -> list[CurrentStep]:
    """Return the steps between plateaus of the current, from the share `start` of their change on."""
    steps = []
    for (a, b), (c, d) in _plateau_pairs(stretch, tolerance_A):
        before, after = float(np.median(stretch.current[a:b])), float(np.median(stretch.current[c:d]))
        near = np.abs(stretch.current[a:d] - before) <= max(0.1 * abs(after - before), tolerance_A / 3.0)
        at = a + int(np.flatnonzero(near[: c - a])[-1]) + 1 if near[: c - a].any() else c
        short = np.abs(stretch.current[at:d] - after) <= max(0.1 * abs(after - before), tolerance_A)
        slow = np.argmax(short) > StepLimits.MAX_STEP_S * stretch.rate_Hz
        if slow or abs(after - before) < StepLimits.MIN_STEP * tolerance_A:
            continue
        time, doubt = _locate_step(stretch, at, before + start * (after - before))
        steps.append(CurrentStep(at, time, doubt, before, after))
    return steps


def time_step(stretch: Stretch, step: CurrentStep, force: F, noise_N: float, rules: BenchRules) -> ReadStep | str:
    """Return the response of `force` (n,) to a step, or why none can be read."""
    rate, v = stretch.rate_Hz, stretch.speed
    a, end = step.at - round(StepLimits.BEFORE_S * rate), min(step.at + round(StepLimits.MAX_AFTER_S * rate), len(v))
    if a < 0:
        return "the step is at the recording's edge"
    speed = float(v[a : step.at].mean())
    close = np.abs(v[a:end] - speed) <= StepLimits.SPEED_SHARE * abs(speed)
    later = step.at + round(StepLimits.MAX_STEP_S * rate)
    changed = np.flatnonzero(np.abs(stretch.current[later:end] - step.to_A) > 0.5 * abs(step.to_A - step.from_A))
    stop = end if not len(changed) else later + int(changed[0])
    stop = stop if close.all() else min(stop, a + int(np.argmin(close)))
    if stop - step.at < StepLimits.PLATEAU_S * rate:
        before_s, after_s = StepLimits.BEFORE_S, StepLimits.PLATEAU_S
        return f"the speed is not constant (within 10 %) from {before_s:g} s before to {after_s:g} s after the step"
    y, t = force[a:stop], stretch.time_s[a:stop] - step.time_s
    if not np.isfinite(y).all():
        return NOT_SEEN
    return _read_response(y, t, step.at - a, speed, noise_N, rules.settled_for_ms)


def _read_response(y: F, t: F, at: int, speed: float, noise_N: float, stay_ms: float) -> ReadStep | str:
    """Return the response of a force y (n,) at times t [s] from the step, which is at sample `at`."""
    last = max((len(y) - at) // 3, 2)
    before, after = float(y[:at].mean()), float(y[-last:].mean())
    change = after - before
    least = StepLimits.MIN_FORCE_CHANGE * noise_N
    if abs(change) < least:
        if np.abs(median_filter(y[at:], 3) - before).max() >= least:
            return f"{NO_STEP}: {DIP}"
        return f"{NO_STEP}: it changes by less than {StepLimits.MIN_FORCE_CHANGE:g} times its noise"
    if max(abs(_drift(y[:at])), abs(_drift(y[-last:]))) > StepLimits.UNSETTLED * abs(change):
        return "the force is not steady before the step, or has not settled before the speed or the current changes"
    share = (y - before) / change
    shares = median_filter(share, 3)
    noise, stay = noise_N / abs(change), max(1e-3 * stay_ms, float(t[1] - t[0]))
    margin = max(StepLimits.MIN_DIP, DynoLimits.BEYOND_NOISE * noise)
    t63, t90 = (_find_reached(t[at - 1 :], shares[at - 1 :], s, stay, noise, margin) for s in (0.632, 0.9))
    t10, t28 = (_find_left(t[at - 1 :], shares[at - 1 :], s, t63, margin) for s in (0.1, 0.283))
    fall = float((np.maximum.accumulate(np.clip(shares[at:], 0.0, 1.0)) - shares[at:]).max())
    if not t63 <= StepLimits.MAX_T63_SHARE * t[-1]:
        return "the response is too slow for the time at a constant speed"
    constant = 1.5 * (t63 - t28)
    t90 = t90 if np.isfinite(t90) else np.nan
    row = StepResponse(
        direction=COMPRESSION if speed > 0.0 else REBOUND,
        speed_m_s=speed,
        before_N=before,
        after_N=after,
        time_63_s=t63,
        time_90_s=t90,
        dip=fall if fall > margin else 0.0,
        dead_time_s=t63 - constant,
        time_constant_s=constant,
        rise_s=t90 - t10,
    )
    samples = max(SMOOTH_POINTS * TRACE_STEP_S / float(t[1] - t[0]), 2.25)  # for one value, as without a parabola
    smoothed = noise * float(np.sqrt(2.25 / samples))
    return ReadStep(row, np.asarray(np.interp(TRACE_S, t, share, right=np.nan)), smoothed, float(t[-1]))


def _plateau_pairs(stretch: Stretch, tolerance_A: float) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Yield neighbouring stretches [start, stop) of constant current."""
    window = max(2, round(StepLimits.PLATEAU_S * stretch.rate_Hz))
    spread = maximum_filter1d(stretch.current, window) - minimum_filter1d(stretch.current, window)
    flat = np.concatenate([[0], (spread <= tolerance_A).astype(np.int8), [0]])
    starts, stops = np.flatnonzero(np.diff(flat) == 1), np.flatnonzero(np.diff(flat) == -1)
    reach = window // 2 - 1  # the filters' windows are centred
    size = len(stretch.current)
    spans = [(max(int(a) - reach, 0), min(int(b) + reach, size)) for a, b in zip(starts, stops, strict=True)]
    for before, after in pairwise(spans):
        if after[0] - before[1] <= StepLimits.MAX_STEP_S * stretch.rate_Hz + 2:
            yield before, after


def _locate_step(stretch: Stretch, at: int, level_A: float) -> tuple[float, float]:
    """Return when the current crosses a level and half the interval [s] in which it did; it first left at sample `at`.

    A change within one interval of the logged current is placed in its middle.
    """
    logged, now = stretch.current_s, float(stretch.time_s[at])
    index = int(np.searchsorted(logged, now + 1e-9, side="right")) - 1
    grid = 0.5 / stretch.rate_Hz
    if index < 1:
        return now - grid, grid
    near = logged[index - 1 : index + round(StepLimits.MAX_STEP_S * stretch.rate_Hz) + 1]
    values = stretch.current[np.clip(np.searchsorted(stretch.time_s, near - 1e-9), 0, len(stretch.current) - 1)]
    beyond = (values - level_A) * np.sign(level_A - values[0]) >= 0.0
    k = max(int(beyond.argmax()), 1)
    interval, jump = float(near[k] - near[k - 1]), float(values[k] - values[k - 1])
    if interval > TickLimits.MIN_GAP_S:
        return float(near[k]), grid
    whole = abs(float(np.ptp(values)))
    share = 0.5 if abs(jump) > 0.5 * whole or not jump else float((level_A - values[k - 1]) / jump)
    return float(near[k - 1]) + np.clip(share, 0.0, 1.0) * interval, 0.5 * interval


def _drift(y: F) -> float:
    """Return how much the second half of y (n,) differs from the first."""
    middle = len(y) // 2
    return float(y[middle:].mean() - y[:middle].mean())


def _find_reached(t: F, y: F, share: float, stay_s: float, noise: float, margin: float) -> float:
    """Return when y (n,) reaches `share` and stays for `stay_s`, to `margin`; infinite if never."""
    window = max(int(np.searchsorted(t, t[0] + stay_s)), 1)
    lowest = np.array([y[k : k + window].min() for k in range(len(y))])
    stays = np.flatnonzero((y >= share) & (lowest >= share - margin))
    if not len(stays):
        return np.inf
    first = int(stays[0])
    clear = y[first : first + window] >= share + StepLimits.VISIBLE * noise
    end = first + int(clear.argmax()) if clear.any() else first + window
    below = np.flatnonzero(y[first:end] < share)  # noise about the share: the middle of both crossings
    last = first if not len(below) else min(first + int(below[-1]) + 1, len(y) - 1)
    return 0.5 * (_between(t, y, first, share) + _between(t, y, last, share))


def _find_left(t: F, y: F, share: float, before_s: float, margin: float) -> float:
    """Return when y (n,) last leaves `share` upwards before a time, infinite if that is."""
    if not np.isfinite(before_s):
        return np.inf
    end = int(np.searchsorted(t, before_s))
    low = np.flatnonzero(y[:end] <= share - margin)
    start = int(low[-1]) if len(low) else 0
    first = start + int((y[start : end + 1] >= share).argmax())
    below = np.flatnonzero(y[start:end] < share)
    last = start + int(below[-1]) + 1 if len(below) else first
    return 0.5 * (_between(t, y, first, share) + _between(t, y, last, share))


def _between(t: F, y: F, k: int, share: float) -> float:
    """Return when y (n,) crosses `share` between the samples k - 1 and k."""
    if k == 0 or y[k] == y[k - 1]:
        return float(t[k])
    return float(t[k - 1] + np.clip((share - y[k - 1]) / (y[k] - y[k - 1]), 0.0, 1.0) * (t[k] - t[k - 1]))


def group_steps(steps: Sequence[ReadStep], tolerance_A: float) -> list[list[ReadStep]]:
    """Return the steps that were read in groups of one change, direction, speed and source, in this order."""
    read = [step for step in steps if step.trace is not None]
    levels = [_number_levels([getattr(s.row, name) for s in read], tolerance_A) for name in ("from_A", "to_A")]
    speeds = _number_levels([float(np.log(abs(s.row.speed_m_s))) for s in read], 2.0 * StepLimits.SPEED_SHARE)
    groups: dict[tuple[int, int, str, int, bool, str], list[ReadStep]] = {}
    for step, a, b, speed in zip(read, *levels, speeds, strict=True):
        row = step.row
        groups.setdefault((a, b, row.direction, speed, row.source != MEASURED, row.source), []).append(step)
    return [group for _, group in sorted(groups.items(), key=lambda item: item[0])]


def average_steps(group: Sequence[ReadStep], rules: BenchRules) -> tuple[ValveResponse, list[ResponsePoint]]:
    """Return the mean response of a group, and its mean course as long as all its steps last."""

    def average(name: str) -> float:
        return float(np.mean([getattr(step.row, name) for step in group]))

    doubt, few = average("time_doubt_s"), len(group) < DynoLimits.MIN_REPEATS
    key: dict[str, Any] = {"source": group[0].row.source, "direction": group[0].row.direction}
    key |= {name: average(name) for name in ("from_A", "to_A", "speed_m_s")} | {"steps": len(group)}
    times: dict[str, Any] = {name: average(name) for name in TIMES}
    times |= {f"{n[:-2]}_ci95_s": _half_interval(group, n, doubt if n in SINCE_STEP else 0.0) for n in TIMES}
    traces = np.stack([step.trace for step in group if step.trace is not None])
    noise = float(np.sqrt(np.mean([step.noise**2 for step in group])))
    change = average("after_N") - average("before_N")
    response = ValveResponse(
        **key,
        change=HARDER if change * key["speed_m_s"] > 0.0 else SOFTER,
        force_change_N=change,
        **times,
        **_read_end(traces, noise, doubt, min(step.lasts_s for step in group), rules),
        dips=sum(step.row.dip > 0.0 for step in group),
        note=f"fewer than {DynoLimits.MIN_REPEATS} steps: no interval" if few else "",
    )
    points = []
    for time, shares in zip(TRACE_S, traces.T, strict=True):
        if np.isfinite(shares).all():
            sd = np.nan if few else float(shares.std(ddof=1))
            points.append(ResponsePoint(**key, time_s=float(time), share=float(shares.mean()), share_sd=sd))
    return response, points


def _read_end(traces: F, noise: float, doubt_s: float, lasts_s: float, rules: BenchRules) -> dict[str, Any]:
    """Return overshoot and settling of the mean of traces (n, times), with intervals by jackknife.

    `noise` is that of a trace, a share of the change. Few steps have no interval. A settling later than the middle of
    what is read is not known: the end is not settled enough to measure it by.
    """
    count = len(traces)
    left = noise / np.sqrt(count)
    overshoot, settled = _overshoot_and_settling(traces.mean(axis=0), left, rules)
    settled = settled if settled <= StepLimits.MAX_SETTLED_SHARE * lasts_s else np.nan
    columns = {"overshoot": overshoot, "settled_s": settled}
    if count < DynoLimits.MIN_REPEATS:
        return columns
    without = np.array(
        [_overshoot_and_settling(np.delete(traces, k, axis=0).mean(axis=0), left, rules) for k in range(count)]
    )
    sd = np.sqrt((count - 1) / count * np.sum((without - without.mean(axis=0)) ** 2, axis=0))
    reach = student.ppf(0.5 + ErrorLimits.LEVEL / 2, count - 1) * sd
    return columns | {"overshoot_ci95": float(reach[0]), "settled_ci95_s": float(reach[1] + doubt_s) + 0.0 * settled}


def _overshoot_and_settling(trace: F, noise: float, rules: BenchRules) -> tuple[float, float]:
    """Return the overshoot (0 if noise explains it) and when the trace settles [s] by the rules; NaN if unknown."""
    after = (TRACE_S >= 0.0) & np.isfinite(trace)
    t, y = TRACE_S[after], trace[after]
    if len(y) <= SMOOTH_POINTS:
        return np.nan, np.nan
    y = savgol_filter(y, SMOOTH_POINTS, 2)
    above = float(y.max() - 1.0)
    overshoot = above if above > StepLimits.VISIBLE * noise else 0.0
    stay = max(round(1e-3 * rules.settled_for_ms / TRACE_STEP_S), 1)
    near = np.abs(y - 1.0) <= rules.settled_share
    run = np.convolve(near, np.ones(stay), "valid") == stay
    if StepLimits.VISIBLE * noise > rules.settled_share or not run.any():
        return overshoot, np.nan
    k = int(run.argmax())
    edge = 1.0 + np.copysign(rules.settled_share, y[max(k - 1, 0)] - 1.0)
    return overshoot, _between(t, y, k, float(edge))


def _half_interval(group: Sequence[ReadStep], name: str, doubt_s: float) -> float:
    """Return half the 95 % interval of the mean [s], widened by a doubt that steps may share; NaN for few steps."""
    if len(group) < DynoLimits.MIN_REPEATS:
        return np.nan
    values = np.array([getattr(step.row, name) for step in group])
    reach = student.ppf(0.5 + ErrorLimits.LEVEL / 2, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values))
    return float(reach + doubt_s)


def _number_levels(currents: Sequence[float], tolerance_A: float) -> list[int]:
    """Return the number of the level of each current."""
    groups = group_values(np.array(currents), tolerance_A)
    number = {index: number for number, members in enumerate(groups) for index in members.tolist()}
    return [number[index] for index in range(len(currents))]
