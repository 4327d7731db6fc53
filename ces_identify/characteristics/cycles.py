"""Cycles of a stretch: between two turning points at full rebound. Which of them repeat at a constant current.

A cycle is used if its stroke is nearly that of its neighbours (sine, triangle, slow sweep), the current stays constant
from `SETTLE_S` before it to its end, and there are enough samples and bandwidth. The others are counted by reason.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d
from scipy.signal import find_peaks

from ces_identify.characteristics.motion import MEASURED, Stretch
from ces_identify.numerics.arrays import F, I, Mask

HALF = 100  # samples of each half of a cycle after resampling
SMOOTH = 5  # instants over which the speed is averaged: less noise in slow cycles, a sine gets 0.1 % lower
MIN_SAMPLES = 20  # of a cycle
MIN_BANDWIDTH_RATIO = 5.0  # bandwidth over the frequency of the cycle: the speed of a sine is 0.2 % low
MIN_PROMINENCE = 0.01  # of the stroke's span: smaller turns are no reversals
NOISE_PROMINENCE = 8.0  # times the noise of the speed, over one period of the bandwidth
MAX_SHAPE_DIFFERENCE = 0.06  # RMS between neighbours, of half the stroke
MAX_PERIOD_DIFFERENCE = 0.15  # between neighbours, of the period
MIN_REPEATS = 3  # cycles in a row that resemble each other
SETTLE_S = 0.1  # [s] before a cycle in which the current must be constant, too
QUIET = "used"
REASONS = (
    "its stroke does not repeat (neighbouring cycles differ)",
    "the current changes within the cycle or the 0.1 s before it",
    f"fewer than {MIN_SAMPLES} position samples in a cycle",
    f"the bandwidth of the speed is below {MIN_BANDWIDTH_RATIO:g} times the cycle's frequency",
    "no measured force over the whole cycle",
    "its peak speed is less than 10 times the noise of the speed",
)


@dataclass(frozen=True)
class Cycles:
    """n cycles resampled to 2 * HALF + 1 instants each: compression in the first half, rebound in the second.

    `time_s` (n, instants) counts from the recording's first sample; `current_A` (n,) is the mean in the cycle;
    `reason` (n,) is an index into REASONS, -1 for a cycle that is used; `recording` (n,) is its number.
    """

    time_s: F
    position: F
    speed: F
    forces: dict[str, F]
    current_A: F
    reason: I
    recording: I

    @property
    def used(self) -> Mask:
        """Which cycles are used, shape (n,)."""
        return self.reason < 0

    def select(self, mask: Mask) -> Cycles:
        """Return the cycles where `mask` (n,) is true."""
        arrays = {
            k: getattr(self, k)[mask] for k in ("time_s", "position", "speed", "current_A", "reason", "recording")
        }
        return Cycles(forces={name: force[mask] for name, force in self.forces.items()}, **arrays)


def find_cycles(stretch: Stretch, number: int, tolerance_A: float, speed_noise: float, bandwidth_Hz: float) -> Cycles:
    """Return the cycles of a stretch of recording `number`; currents within `tolerance_A` count as constant."""
    low, high = find_reversals(stretch, speed_noise / bandwidth_Hz)
    at = _resample_instants(stretch.speed, low, high)
    forces = {source: _interpolate(force, at) for source, force in stretch.forces.items()}
    position, speed = _interpolate(stretch.position, at), _smooth(_interpolate(stretch.speed, at))
    first, last = at[:, 0], at[:, -1]
    period = (last - first) / stretch.rate_Hz
    failed = np.stack(
        [
            ~_find_repeats(position, period),
            ~constant_between(stretch, first, last, tolerance_A),
            last - first < MIN_SAMPLES,
            period * bandwidth_Hz < MIN_BANDWIDTH_RATIO,
            ~np.isfinite(forces[MEASURED]).all(axis=1),
            np.minimum(speed.max(axis=1, initial=0.0), -speed.min(axis=1, initial=0.0)) < 10.0 * speed_noise,
        ]
    )
    return Cycles(
        time_s=_interpolate(stretch.time_s, at),
        position=position,
        speed=speed,
        forces=forces,
        current_A=_mean_between(stretch.current, first, last),
        reason=np.where(failed.any(axis=0), failed.argmax(axis=0), -1).astype(np.int64),
        recording=np.full(len(at), number, np.int64),
    )


def find_reversals(stretch: Stretch, noise_m: float) -> tuple[I, I]:
    """Return the samples at full rebound (c + 1,) and full compression (c,) between them, for c cycles."""
    x = stretch.position
    low, high = np.percentile(x, (1.0, 99.0))
    least = max(MIN_PROMINENCE * float(high - low), NOISE_PROMINENCE * noise_m, 1e-12)
    tops, bottoms = find_peaks(x, prominence=least)[0], find_peaks(-x, prominence=least)[0]
    turns = np.concatenate([tops, bottoms])
    kinds = np.concatenate([np.ones(len(tops), np.int64), -np.ones(len(bottoms), np.int64)])
    order = np.argsort(turns, kind="stable")
    turns, kinds = _alternate(x, turns[order], kinds[order])
    first = int(np.argmax(kinds < 0)) if (kinds < 0).any() else len(kinds)
    turns = turns[first:]
    count = max((len(turns) - 1) // 2, 0)
    return turns[: 2 * count + 1 : 2], turns[1 : 2 * count : 2]


def constant_between(stretch: Stretch, first: F, last: F, tolerance_A: float) -> Mask:
    """Return whether the current is constant between fractional samples `first` and `last` (n,) and SETTLE_S before."""
    early = first - SETTLE_S * stretch.rate_Hz
    spans = zip(np.maximum(early, 0.0).astype(int), np.ceil(last).astype(int) + 1, strict=True)
    widths = [float(np.ptp(np.percentile(stretch.current[a:b], (2.0, 98.0)))) for a, b in spans]
    return np.asarray([width <= tolerance_A for width in widths], dtype=np.bool_)


def steady_current(stretch: Stretch, tolerance_A: float) -> Mask:
    """Return where (n,) the current has been constant for SETTLE_S."""
    window = max(2, round(SETTLE_S * stretch.rate_Hz))
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
    if len(position) < MIN_REPEATS:
        return np.zeros(len(position), np.bool_)
    half = 0.5 * np.ptp(position, axis=1)
    scale = np.minimum(half[1:], half[:-1])
    shape = np.sqrt(np.mean(np.diff(position, axis=0) ** 2, axis=1)) <= MAX_SHAPE_DIFFERENCE * scale
    same = shape & (np.abs(np.diff(period)) <= MAX_PERIOD_DIFFERENCE * np.minimum(period[1:], period[:-1]))
    repeats = np.zeros(len(position), np.bool_)
    for k in range(len(position) - MIN_REPEATS + 1):
        if same[k : k + MIN_REPEATS - 1].all():
            repeats[k : k + MIN_REPEATS] = True
    return repeats


def _smooth(speed: F) -> F:
    """Return the speeds (c, instants) averaged over the phase; unlike a polynomial this never overshoots at corners."""
    if not len(speed):
        return speed
    smooth = uniform_filter1d(speed[:, :-1], SMOOTH, axis=1, mode="wrap")  # the last instant is the first of the next
    return np.asarray(np.concatenate([smooth, smooth[:, :1]], axis=1))


def _interpolate(values: F, at: F) -> F:
    return np.asarray(np.interp(at.ravel(), np.arange(len(values)), values)).reshape(at.shape)


def _mean_between(values: F, first: F, last: F) -> F:
    total = np.concatenate([[0.0], np.cumsum(values)])
    a, b = first.astype(int), np.ceil(last).astype(int) + 1
    b = np.minimum(b, len(values))
    return np.asarray((total[b] - total[a]) / np.maximum(b - a, 1))


def join_cycles(parts: list[Cycles]) -> Cycles:
    """Return the cycles of all stretches one after the other; `parts` is not empty."""
    names = ("time_s", "position", "speed", "current_A", "reason", "recording")
    joined = {name: np.concatenate([getattr(p, name) for p in parts]) for name in names}
    forces = {source: np.concatenate([p.forces[source] for p in parts]) for source in parts[0].forces}
    return Cycles(forces=forces, **joined)
