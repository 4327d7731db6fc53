"""Cycles of a stretch between turning points at full rebound: which of them repeat, and what each says.

A cycle is used if its stroke is nearly that of its neighbours (sine, triangle, slow sweep), the current stays constant
from `SETTLE_S` before it to its end, and there are enough samples and bandwidth. The others are counted by reason.
Compression is the half with rising position, rebound the other. In each half the speed first rises to its peak (the
accelerating branch) and then falls to zero (the decelerating branch).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d
from scipy.signal import find_peaks

from ces_data.arrays import F, I, Mask
from ces_identify.characteristics.motion import MEASURED, RecordingMotion, Stretch
from ces_identify.characteristics.rules import CENTRE, MAXIMUM, BenchRules
from ces_identify.limits import DynoLimits

HALF = 100  # samples of each half of a cycle after resampling
SMOOTH = 5  # instants over which the speed is averaged: less noise in slow cycles, a sine gets 0.1 % lower
REASONS = (
    "its stroke does not repeat (neighbouring cycles differ)",
    "the current changes within the cycle or the 0.1 s before it",
    f"fewer than {DynoLimits.MIN_SAMPLES} position samples in a cycle",
    f"the bandwidth of the speed is below {DynoLimits.MIN_BANDWIDTH_RATIO:g} times the cycle's frequency",
    "no measured force over the whole cycle",
    f"its peak speed is less than {DynoLimits.MIN_PEAK:g} times the noise of the speed",
)

COMPRESSION, REBOUND = "compression", "rebound"
DIRECTIONS = (COMPRESSION, REBOUND)
EVEN = 7  # instants of a half over which the speed is averaged to find the peak: 0.2 % lower for a sine
SHARES = np.round(np.arange(1, 20) * 0.05, 2)  # of the peak speed, at which the branches are read
SKEW_S = 1e-3  # [s] delay between force and position whose effect on widths is stated
ARRAYS = ("time_s", "position", "speed", "current_A", "reason", "recording", "branch")  # of cycles, beside the forces


@dataclass(frozen=True)
class Cycles:
    """n cycles resampled to 2 * HALF + 1 instants each: compression in the first half, rebound in the second.

    `time_s` (n, instants) counts from the recording's first sample; `current_A` (n,) is the mean in the cycle;
    `reason` (n,) is an index into REASONS, -1 for a cycle that is used; `recording` (n,) is its number. `branch` (n,)
    is 1 where the current was raised to its level, -1 where it was lowered, 0 where nothing is known of before.
    """

    time_s: F
    position: F
    speed: F
    forces: dict[str, F]
    current_A: F
    reason: I
    recording: I
    branch: I

    @property
    def used(self) -> Mask:
        """Which cycles are used, shape (n,)."""
        return self.reason < 0

    def select(self, which: Mask | I) -> Cycles:
        """Return the cycles where a mask (n,) is true, or those of these indices."""
        arrays = {name: getattr(self, name)[which] for name in ARRAYS}
        return Cycles(forces={name: force[which] for name, force in self.forces.items()}, **arrays)


def find_cycles(stretch: Stretch, number: int, tolerance_A: float, speed_noise: float, bandwidth_Hz: float) -> Cycles:
    """Return the cycles of a stretch of recording `number`; currents within `tolerance_A` count as constant."""
    low, high = find_reversals(stretch, speed_noise / bandwidth_Hz)
    at = _resample_instants(stretch.speed, low, high)
    forces = {source: _interpolate(force, at) for source, force in stretch.forces.items()}
    position, speed = _interpolate(stretch.position, at), _interpolate(stretch.speed, at)
    if len(at):  # averaged over the phase: unlike a polynomial this never overshoots at corners
        speed[:, :-1] = uniform_filter1d(speed[:, :-1], SMOOTH, axis=1, mode="wrap")
        speed[:, -1] = speed[:, 0]  # the first instant of the next cycle
    first, last = at[:, 0], at[:, -1]
    period = (last - first) / stretch.rate_Hz
    checks = [
        ~_find_repeats(position, period),
        ~constant_between(stretch, first, last, tolerance_A),
        last - first < DynoLimits.MIN_SAMPLES,
        period * bandwidth_Hz < DynoLimits.MIN_BANDWIDTH_RATIO,
        ~np.isfinite(forces[MEASURED]).all(axis=1),
        np.minimum(speed.max(axis=1, initial=0.0), -speed.min(axis=1, initial=0.0)) < DynoLimits.MIN_PEAK * speed_noise,
    ]
    failed, total = np.stack(checks), np.concatenate([[0.0], np.cumsum(stretch.current)])
    a, b = first.astype(int), np.minimum(np.ceil(last).astype(int) + 1, len(stretch.current))
    return Cycles(
        time_s=_interpolate(stretch.time_s, at),
        position=position,
        speed=speed,
        forces=forces,
        current_A=np.asarray((total[b] - total[a]) / np.maximum(b - a, 1)),
        reason=np.where(failed.any(axis=0), failed.argmax(axis=0), -1).astype(np.int64),
        recording=np.full(len(at), number, np.int64),
        branch=np.zeros(len(at), np.int64),
    )


def find_branches(cycles: Cycles, motions: Sequence[RecordingMotion], tolerance_A: float, first: int) -> I:
    """Return the branch of each cycle (n,), by the last other steady current before it; without one it is `first`."""
    branch = np.zeros(len(cycles.current_A), np.int64)
    for number, stretches in enumerate(motion.stretches for motion in motions):
        own = np.flatnonzero(cycles.recording == number)
        held = [(s.time_s[steady], s.current[steady]) for s in stretches for steady in [steady_current(s, tolerance_A)]]
        if not len(own):
            continue
        time, current = (np.concatenate(parts) for parts in zip(*held, strict=True))
        state, level, begin = first, np.nan, 0
        for index, end in zip(own, np.searchsorted(time, cycles.time_s[own, 0]), strict=True):
            now = cycles.current_A[index]
            before = np.append(level, current[begin:end])
            other = before[np.abs(before - now) > tolerance_A]
            state = int(np.sign(now - other[-1])) if len(other) else state
            branch[index], level, begin = state, now, end
    return branch


def last_of_holds(cycles: Cycles) -> Mask:
    """Return which cycles (n,), all of one condition, are the last of a hold: of those that follow one another."""
    start, end = cycles.time_s[:, 0], cycles.time_s[:, -1]
    follows = (cycles.recording[1:] == cycles.recording[:-1]) & (start[1:] - end[:-1] < 0.5 * (end - start)[1:])
    return np.append(~follows, True)


def find_reversals(stretch: Stretch, noise_m: float) -> tuple[I, I]:
    """Return the samples at full rebound (c + 1,) and full compression (c,) between them, for c cycles."""
    x = stretch.position
    low, high = np.percentile(x, (1.0, 99.0))
    least = max(DynoLimits.MIN_PROMINENCE * float(high - low), DynoLimits.BEYOND_NOISE * noise_m, 1e-12)
    tops, bottoms = find_peaks(x, prominence=least)[0], find_peaks(-x, prominence=least)[0]
    turns = np.concatenate([tops, bottoms])
    kinds = np.concatenate([np.ones(len(tops), np.int64), -np.ones(len(bottoms), np.int64)])
    order = np.argsort(turns, kind="stable")
    turns, kinds = _alternate(x, turns[order], kinds[order])
    begin = int(np.argmax(kinds < 0)) if (kinds < 0).any() else len(kinds)
    turns = turns[begin:]
    count = max((len(turns) - 1) // 2, 0)
    return turns[: 2 * count + 1 : 2], turns[1 : 2 * count : 2]


def constant_between(stretch: Stretch, first: F, last: F, tolerance_A: float) -> Mask:
    """Return whether the current is constant between fractional samples `first` and `last` (n,) and SETTLE_S before."""
    early = first - DynoLimits.SETTLE_S * stretch.rate_Hz
    spans = zip(np.maximum(early, 0.0).astype(int), np.ceil(last).astype(int) + 1, strict=True)
    widths = [float(np.ptp(np.percentile(stretch.current[a:b], (2.0, 98.0)))) for a, b in spans]
    return np.asarray([width <= tolerance_A for width in widths], dtype=np.bool_)


def steady_current(stretch: Stretch, tolerance_A: float) -> Mask:
    """Return where (n,) the current has been constant for SETTLE_S."""
    window = max(2, round(DynoLimits.SETTLE_S * stretch.rate_Hz))
    shift = (window - 1) // 2  # the window ends at the sample
    top = maximum_filter1d(stretch.current, window, origin=shift, mode="nearest")
    bottom = minimum_filter1d(stretch.current, window, origin=shift, mode="nearest")
    return np.asarray(top - bottom <= tolerance_A)


def _alternate(x: F, turns: I, kinds: I) -> tuple[I, I]:
    """Return turning points of alternating kind; of several in a row the most extreme stays."""
    if not len(turns):
        return turns, kinds
    runs = np.split(np.arange(len(turns)), np.flatnonzero(np.diff(kinds)) + 1)
    best = np.array([run[np.argmax(x[turns[run]] * kinds[run])] for run in runs])
    return turns[best], kinds[best]


def _resample_instants(speed: F, low: I, high: I) -> F:
    """Return fractional samples (c, 2 HALF + 1): uniform in time from zero speed to zero speed in each half."""
    a, m, b = (_zero_crossings(speed, turns) for turns in (low[:-1], high, low[1:]))
    share = np.arange(HALF) / HALF
    parts = [a[:, None] + (m - a)[:, None] * share, m[:, None] + (b - m)[:, None] * share, b[:, None]]
    return np.concatenate(parts, axis=1)


def _zero_crossings(speed: F, turns: I) -> F:
    """Return the fractional samples nearest `turns` (c,) where the speed changes its sign."""
    at = turns.astype(np.float64)
    for i, turn in enumerate(turns):
        a = max(int(turn) - 2, 0)
        v = speed[a : int(turn) + 4]
        change = np.flatnonzero(v[:-1] * v[1:] <= 0.0)
        if len(change):
            k = change[np.argmin(np.abs(change + a - turn))]
            rise = v[k] - v[k + 1]
            at[i] = a + k + (v[k] / rise if rise else 0.5)
    return at


def _find_repeats(position: F, period: F) -> Mask:
    """Return which cycles (n,) are in a row of MIN_REPEATS whose neighbours have the same stroke and period."""
    half = 0.5 * np.ptp(position, axis=1)
    scale = np.minimum(half[1:], half[:-1])
    shape = np.sqrt(np.mean(np.diff(position, axis=0) ** 2, axis=1)) <= DynoLimits.MAX_SHAPE_DIFFERENCE * scale
    same = shape & (np.abs(np.diff(period)) <= DynoLimits.MAX_PERIOD_DIFFERENCE * np.minimum(period[1:], period[:-1]))
    repeats = np.zeros(len(position), np.bool_)
    for k in range(len(position) - DynoLimits.MIN_REPEATS + 1):
        if same[k : k + DynoLimits.MIN_REPEATS - 1].all():
            repeats[k : k + DynoLimits.MIN_REPEATS] = True
    return repeats


def _interpolate(values: F, at: F) -> F:
    return np.asarray(np.interp(at.ravel(), np.arange(len(values)), values)).reshape(at.shape)


def group_values(values: F, tolerance: float) -> list[I]:
    """Return the indices of each group of values (n,) that are close together, in rising order.

    Groups are separated by gaps of at least half the `tolerance`; one wider than twice the tolerance is cut into pieces
    one tolerance wide.
    """
    if not len(values):
        return []
    order = np.argsort(values, kind="stable")
    groups: list[I] = []
    for group in np.split(order, np.flatnonzero(np.diff(values[order]) > 0.5 * tolerance) + 1):
        above = values[group] - values[group[0]]
        cuts = np.flatnonzero(np.diff(np.floor(above / tolerance))) + 1
        groups += np.split(group, cuts) if above[-1] > 2.0 * tolerance else [group]
    return groups


def join_cycles(parts: list[Cycles]) -> Cycles:
    """Return the cycles of all stretches one after the other; `parts` is not empty."""
    joined = {name: np.concatenate([getattr(p, name) for p in parts]) for name in ARRAYS}
    forces = {source: np.concatenate([p.forces[source] for p in parts]) for source in parts[0].forces}
    return Cycles(forces=forces, **joined)


@dataclass(frozen=True)
class HalfValues:
    """One direction of n cycles.

    `speed` (n,) and `force` (n,) are read by the bench's rules. `peak_speed` (n,) is the mean over the stretch where
    the speed is at least PEAK_SHARE of its largest; `accelerating` and `decelerating` (n, shares) are the forces at
    SHARES of it.
    """

    speed: F
    force: F
    peak_speed: F
    accelerating: F
    decelerating: F

    @property
    def mean(self) -> F:
        """The mean force of both branches (n, shares)."""
        return 0.5 * (self.accelerating + self.decelerating)

    @property
    def width(self) -> F:
        """How much more the decelerating branch resists than the accelerating one (n, shares)."""
        return np.sign(self.peak_speed)[:, None] * (self.decelerating - self.accelerating)


@dataclass(frozen=True)
class CycleValues:
    """Values (n,) of n cycles: `work_J`, the viscous damping of the same work, and the forces at zero speed.

    `top_N` is the force at full compression, `bottom_N` at full rebound; `width_per_skew_N` is how much their
    difference changes if the force is delayed by SKEW_S.
    """

    work_J: F
    damping_Ns_m: F
    power_W: F
    top_N: F
    bottom_N: F
    width_per_skew_N: F
    halves: dict[str, HalfValues]


def evaluate_cycles(cycles: Cycles, source: str, rules: BenchRules) -> CycleValues:
    """Return the values of cycles by the force of one source; NaN for a cycle without it."""
    force, x, v, t = cycles.forces[source], cycles.position, cycles.speed, cycles.time_s
    force = np.where(np.isfinite(force).all(axis=1, keepdims=True), force, np.nan)
    straight = 0.5 * (force[:, 0] + force[:, -1]) * (x[:, 0] - x[:, -1])  # closes the loop of force over position
    work = np.sum(0.5 * (force[:, 1:] + force[:, :-1]) * np.diff(x, axis=1), axis=1) + straight
    period = t[:, -1] - t[:, 0]
    slope = np.gradient(force, axis=1) / np.gradient(t, axis=1)
    bottom_slope = 0.5 * (slope[:, 1] + slope[:, -2])
    rise = (x - x.min(axis=1, keepdims=True)) / np.ptp(x, axis=1)[:, None] - 0.5  # from the centre, in strokes
    up, down = np.s_[:, : HALF + 1], np.s_[:, HALF:]
    return CycleValues(
        work_J=work,
        damping_Ns_m=work / np.sum(0.5 * (v[:, 1:] ** 2 + v[:, :-1] ** 2) * np.diff(t, axis=1), axis=1),
        power_W=work / period,
        top_N=force[:, HALF],
        bottom_N=0.5 * (force[:, 0] + force[:, -1]),
        width_per_skew_N=np.abs(slope[:, HALF] - bottom_slope) * SKEW_S,
        halves={
            COMPRESSION: _evaluate_half(rise[up], v[up], force[up], 1.0, rules),
            REBOUND: _evaluate_half(-rise[down], -v[down], force[down], -1.0, rules),
        },
    )


def _evaluate_half(rise: F, v: F, force: F, sign: float, rules: BenchRules) -> HalfValues:
    """Return the values of a half; `rise` (n, instants) goes from -0.5 to 0.5 with the speed v (n, instants) >= 0."""
    even = uniform_filter1d(v, EVEN, axis=1, mode="nearest")  # the highest of noisy samples is too high
    top = even >= DynoLimits.PEAK_SHARE * even.max(axis=1, keepdims=True)
    count = top.sum(axis=1)
    peak_speed = np.where(top, v, 0.0).sum(axis=1) / count
    middle = np.rint((top * np.arange(v.shape[1])).sum(axis=1) / count).astype(int)
    rising, falling = np.full((2, len(v), len(SHARES)), np.nan)
    for i, m in enumerate(middle):
        wanted = SHARES * peak_speed[i]
        rising[i] = np.interp(wanted, np.maximum.accumulate(v[i, : m + 1]), force[i, : m + 1])
        falling[i] = np.interp(wanted, np.maximum.accumulate(v[i, m:][::-1]), force[i, m:][::-1])
    weights = _weigh_centre(rise, rules.window) if rules.read_at == CENTRE else top / count[:, None]
    whole = np.isfinite(force).all(axis=1)
    read = (weights * force).sum(axis=1)
    if rules.value == MAXIMUM and whole.any():  # where the mean stroke is largest: noise hardly raises that
        inside = np.where((weights > 0.0).mean(axis=0) >= 0.5, sign * force[whole].mean(axis=0), -np.inf)
        read = force[:, inside.argmax()]
    read = np.where(whole, read, np.nan)
    return HalfValues(sign * (weights * v).sum(axis=1), read, sign * peak_speed, rising, falling)


def _weigh_centre(rise: F, window: float) -> F:
    """Return the weights (n, instants) of a window about the centre; if it is empty, those of the crossing."""
    inside = np.abs(rise) <= 0.5 * window
    after = np.clip((rise >= 0.0).argmax(axis=1), 1, None)[:, None]
    a, b = np.take_along_axis(rise, after - 1, axis=1), np.take_along_axis(rise, after, axis=1)
    share = np.clip(-a / np.where(b > a, b - a, 1.0), 0.0, 1.0)
    at = np.arange(rise.shape[1])
    crossing = np.where(at == after, share, 0.0) + np.where(at == after - 1, 1.0 - share, 0.0)
    count = inside.sum(axis=1, keepdims=True)
    return np.where((count > 0) & (window > 0.0), inside / np.maximum(count, 1), crossing)
