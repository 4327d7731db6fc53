"""Preparation: from a recording to uniform ticks, by the rules of the observer.

Position, speed and current at each tick are those that the estimator would have used: the tracker of the tick runs over
whole arrays. Gaps and restarts split a series into segments and are never bridged. Measured force is interpolated to
the ticks, but not over samples that are missing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import floor, log, nan
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ces_data.arrays import F, I, Mask
from ces_data.recording import Channel, Recording
from ces_data.samples import mask_lost, measured_at
from ces_identify.limits import TickLimits
from ces_identify.numerics.core import compile_tick, core_kernel, pointer
from ces_observer.errors import RecordingError
from ces_observer.limits import SpeedLimits
from ces_observer.model import Sampling
from ces_observer.estimator import describe_rate, layout_of, least_rate_Hz
from ces_observer.structures.structure import Range
from ces_observer.tick import tracker
from ces_observer.tick.bank import BANK_POSITION, BANK_SPEED, DELAY, TOTAL
from ces_observer.tick.tracker import (
    AHEAD, BEYOND_STROKE, INNOVATION, LAST_TICK, LATE_AT, LATE_KNOWN, MAX_GAP_NS, MAX_MOTION, OK, OLD_POSITION,
    OLD_SPEED, ORIGIN, OUT_OF_ORDER, OUTLIER, PATIENCE, RESTARTED, TICKS, UNSETTLED,
)  # fmt: skip

DROPPED_OUTLIER = "outlier"  # a reason of `Series.dropped`


@dataclass(frozen=True, repr=False)
class Series:
    """A prepared recording on its ticks.

    Arrays over m ticks: `time_s` from the first position sample, `position` [m], `speed` [m/s], `current` [A],
    `force` [N] (NaN where none was measured). `segments` (s, 2) are [start, stop) ticks without a gap. `scored` (m,)
    is true where a force was measured after the warm-up of `warm_up` ticks. `dropped` counts the omitted position
    samples by reason. After a share `unsettled` of the position samples, which came too late, the vehicle withholds the
    force; `rates` says why.
    """

    name: str
    rate_Hz: float
    time_s: F
    position: F
    speed: F
    current: F
    force: F
    segments: I
    scored: Mask
    warm_up: int
    dropped: dict[str, int]
    unsettled: float = 0.0
    rates: str = ""

    def __len__(self) -> int:
        return len(self.time_s)

    def __repr__(self) -> str:
        return f"Series {self.name}: {len(self)} ticks at {self.rate_Hz:g} Hz, {int(self.scored.sum())} of them scored"

    @property
    def inputs(self) -> F:
        """Position [m], speed [m/s] and current [A], shape (3, ticks)."""
        return np.stack([self.position, self.speed, self.current])

    def part(self, first: float, last: float) -> Series:
        """Return the share [first, last) of the ticks as a series of its own, with its own warm-up."""
        a, b = round(first * len(self)), round(last * len(self))
        segments = np.clip(self.segments, a, b) - a
        scored = self.scored[a:b].copy()
        if a > 0:
            scored[: self.warm_up] = False
        signals = {name: getattr(self, name)[a:b] for name in ("time_s", "position", "speed", "current", "force")}
        return replace(self, **signals, segments=segments[segments[:, 1] > segments[:, 0]], scored=scored)

    def thin(self, every: int) -> Series:
        """Return one minute in `every` of the ticks, each with its own warm-up; the series itself for 1."""
        if every <= 1:
            return self
        minute = np.arange(len(self)) // round(TickLimits.STRETCH_S * self.rate_Hz)
        keep = minute % every == 0
        segment = np.repeat(np.arange(len(self.segments)), np.diff(self.segments)[:, 0])[keep]
        starts = np.flatnonzero((np.diff(segment, prepend=-1) != 0) | (np.diff(minute[keep], prepend=-1) != 0))
        segments = np.stack([starts, np.append(starts[1:], len(segment))], axis=1)
        since_start = np.arange(len(segment)) - np.repeat(starts, np.diff(segments)[:, 0])
        signals = {name: getattr(self, name)[keep] for name in ("time_s", "position", "speed", "current", "force")}
        return replace(self, **signals, segments=segments, scored=self.scored[keep] & (since_start >= self.warm_up))


def changes(values: F) -> bool:
    """Return whether an input (n,) is not constant."""
    return bool(np.ptp(values) > TickLimits.MIN_CHANGE * max(1e-9, float(np.abs(values).max())))


@dataclass(frozen=True)
class PositionSamples:
    """The usable position samples of a recording with the current held at each.

    `index` (n,) are their indices in the position channel; `motion` (n,) is the signal that the sampling names beside
    the position, zero if there is none.
    """

    index: I
    stamps_ns: I
    position: F
    current: F
    motion: F
    dropped: dict[str, int]


def select_samples(recording: Recording, sampling: Sampling) -> PositionSamples:
    """Return the position samples that a model with this `sampling` uses, with the motion signal that it needs.

    A speed or acceleration older than the longest gap is not used. Raises RecordingError if it was not recorded.
    """
    samples = usable_samples(recording, sampling.max_current_age_s)
    motion, name = hold_motion(recording, samples.stamps_ns, sampling), sampling.motion
    if not name:
        return samples
    good = np.abs(motion) <= MAX_MOTION  # not NaN
    if not good.any():
        raise RecordingError(f"{recording.name}: no position sample with a {name} at most {sampling.max_gap_s:g} s old")
    arrays = {key: getattr(samples, key)[good] for key in ("index", "stamps_ns", "position", "current")}
    return PositionSamples(**arrays, motion=motion[good], dropped=samples.dropped | {f"no {name}": int((~good).sum())})


def usable_samples(recording: Recording, max_current_age_s: float) -> PositionSamples:
    """Return the finite position samples that have a finite current no older than `max_current_age_s`."""
    position = recording.channel("position")
    current = hold_current(recording, position.stamps_ns, max_current_age_s)
    finite = np.isfinite(position.values)
    good = finite & np.isfinite(current)
    dropped = {"position not finite": int((~finite).sum()), "no current": int((finite & ~good).sum())}
    if not good.any():
        raise RecordingError(f"{recording.name}: no position sample with a current at most {max_current_age_s} s old")
    index = np.flatnonzero(good)
    still = np.zeros(len(index))
    return PositionSamples(index, position.stamps_ns[index], position.values[index], current[index], still, dropped)


def hold_current(recording: Recording, stamps_ns: I, max_age_s: float) -> F:
    """Return the newest current [A] at or before each stamp, NaN where there is none or it is too old."""
    if "current" in recording.constants:
        return np.full(len(stamps_ns), float(recording.constants["current"]))
    return hold_signal(recording.channel("current"), stamps_ns, max_age_s)


def hold_motion(recording: Recording, stamps_ns: I, sampling: Sampling) -> F:
    """Return the speed [m/s] or acceleration [m/s2] that `sampling` names at each stamp; zero if it names none.

    It is NaN where the newest value is older than the longest gap. Raises RecordingError if it was not recorded.
    """
    name = sampling.motion
    if not name:
        return np.zeros(len(stamps_ns))
    if name not in recording.channels:
        raise RecordingError(
            f"{recording.name}: no '{name}' channel, which the model needs for its speed; "
            f"describe '{name}' in the signals file, or identify on recordings without it"
        )
    return hold_signal(recording.channel(name), stamps_ns, sampling.max_gap_s)


def hold_signal(logged: Channel, stamps_ns: I, max_age_s: float) -> F:
    """Return the newest value at or before each stamp, NaN where there is none or it is too old."""
    channel = _finite(logged)
    order = np.argsort(channel.stamps_ns, kind="stable")
    if not len(order):
        return np.full(len(stamps_ns), np.nan)
    stamps, values = channel.stamps_ns[order], channel.values[order]
    newest = np.searchsorted(stamps, stamps_ns, side="right") - 1
    fresh = (newest >= 0) & (stamps_ns - stamps[newest] <= round(max_age_s * 1e9))
    return np.where(fresh, values[newest], np.nan)


def prepare(recording: Recording, sampling: Sampling, has_spikes: bool = True) -> Series:
    """Return the series of `recording`; raises RecordingError if no segment is longer than the warm-up.

    If it `has_spikes`, those of the force count as not measured; position and current are taken as on the vehicle.
    With a delay, speeds are those known after it; the last ticks of a segment, whose speed is never known, have the
    speed known at once, and are not scored.
    """
    samples = select_samples(recording, sampling)
    tracked = track_samples(samples, sampling)
    ticks, late, stamps_ns, total, status = (
        getattr(tracked, name) for name in ("ticks", "late", "stamps_ns", "total", "status")
    )
    del tracked  # here and below: an hour at 1 kHz is 30 MB an array
    has_speed = np.isfinite(late[:, 1])
    position, speed = (np.where(has_speed, late[:, i], ticks[:, i]) for i in (0, 1))
    del ticks, late
    current = np.repeat(samples.current, np.diff(total, prepend=0))
    starts = total[status == RESTARTED] - 1
    if not len(starts):
        raise RecordingError(f"{recording.name}: {_explain_stroke(status, samples.current, sampling)}")
    time_s, dropped = (stamps_ns - samples.stamps_ns[0]) * 1e-9, samples.dropped
    unsettled, rates = float((status == UNSETTLED).mean()), ""
    if unsettled:
        rates = _describe_rates(samples.stamps_ns, sampling)
    del samples
    segments = np.stack([starts, np.append(starts[1:], len(position))], axis=1)
    force = force_at(recording, stamps_ns, sampling.max_gap_s, has_spikes)
    warm_up = round(sampling.warm_up_s * sampling.rate_Hz)
    longest = np.diff(segments).max() - sampling.delay_ticks
    if longest <= warm_up:
        short = f"too short: the longest stretch without a gap lasts {longest / sampling.rate_Hz:.3g} s; expected more"
        short += f" than {sampling.warm_up_s:g} s, after which there are forces"
        most = (status == BEYOND_STROKE).mean() > TickLimits.MAX_BEYOND
        raise RecordingError(f"{recording.name}: {_explain_stroke(status, current, sampling) if most else short}")
    since_start = np.arange(len(position)) - np.repeat(segments[:, 0], np.diff(segments)[:, 0])
    dropped = dropped | {
        "out of order": int((status == OUT_OF_ORDER).sum()),
        DROPPED_OUTLIER: int((status == OUTLIER).sum()),
        "beyond the stroke": int((status == BEYOND_STROKE).sum()),
    }
    return Series(
        name=recording.name,
        rate_Hz=sampling.rate_Hz,
        time_s=time_s,
        position=position,
        speed=speed,
        current=current,
        force=force,
        segments=segments.astype(np.int64),
        scored=(since_start >= warm_up) & np.isfinite(force) & has_speed,
        warm_up=warm_up,
        dropped=dropped,
        unsettled=unsettled,
        rates=rates,
    )


def _describe_rates(stamps_ns: I, sampling: Sampling) -> str:
    """Return the typical rate of positions, and that which the model needs or has."""
    rate_Hz, least_Hz = 1e9 / max(float(np.median(np.diff(stamps_ns))), 1.0), least_rate_Hz(sampling)
    if rate_Hz < least_Hz:
        return describe_rate(rate_Hz, least_Hz)
    if rate_Hz > sampling.rate_Hz / SpeedLimits.OVERDUE:
        return "many positions are missing"
    return f"positions come at about {rate_Hz:.0f} Hz, the model has {sampling.rate_Hz:.0f} ticks a second"


def _explain_stroke(status: NDArray[np.int8], current: F, sampling: Sampling) -> str:
    """Return that positions of this status (n,) are beyond the model's stroke, and what may be wrong with them."""
    beyond, (low, high) = int((status == BEYOND_STROKE).sum()), sampling.stroke_m
    text = (
        f"{beyond} of {len(status)} positions are beyond {low:.3g} to {high:.3g} m, the model's recorded "
        "stroke and a margin; check unit"
    )
    is_stroke = changes(current) and low <= current.min() and current.max() <= high
    return f"{text} (m), sign and offset of the position{', or is it exchanged with the current?' if is_stroke else ''}"


def track_samples(samples: PositionSamples, sampling: Sampling) -> Tracked:
    """Return the ticks of the samples."""
    return track(samples.stamps_ns, samples.position, sampling, samples.motion)


def force_at(recording: Recording, stamps_ns: I, max_gap_s: float, has_spikes: bool = True) -> F:
    """Return the measured force [N] interpolated at each stamp, NaN where none was measured (see `measured_at`)."""
    if has_spikes and "force" in recording.channels:
        recording = replace(recording, channels={"force": mask_lost(recording, "force")})
    force = interpolate_force(recording, stamps_ns, max_gap_s)
    if np.isfinite(force).any():
        force[~measured_at(recording.channel("force"), stamps_ns)] = np.nan
    return force


def interpolate_force(recording: Recording, stamps_ns: I, max_gap_s: float, name: str = "force") -> F:
    """Return the logged force [N] interpolated at each stamp, NaN outside it and inside gaps beyond `max_gap_s`."""
    if name not in recording.channels:
        return np.full(len(stamps_ns), np.nan)
    channel = _finite(recording.channel(name))
    if len(channel) < 2:
        return np.full(len(stamps_ns), np.nan)
    origin = stamps_ns[0]
    logged = (channel.stamps_ns - origin).astype(np.float64)
    ticks = (stamps_ns - origin).astype(np.float64)
    after = np.clip(np.searchsorted(logged, ticks), 1, len(logged) - 1)
    inside = (ticks >= logged[0]) & (ticks <= logged[-1]) & (np.diff(logged)[after - 1] <= max_gap_s * 1e9)
    return np.where(inside, np.interp(ticks, logged, channel.values), np.nan)


def _finite(channel: Channel) -> Channel:
    return channel.select(np.isfinite(channel.values))


@dataclass(frozen=True)
class FreeRun:
    """Simulated force [N] of shape (ticks,), NaN from where it is not finite to the end of the segment.

    `clamped` marks the ticks with inputs outside the envelope, `held` those with a force held at an end of its own.
    """

    force: F
    clamped: Mask
    held: Mask
    force_envelope_N: Range


class SimulatedSeries(Protocol):
    """A series and a free run on it."""

    @property
    def series(self) -> Series:
        """The series."""

    @property
    def run(self) -> FreeRun:
        """The free run."""


tracker_advance = compile_tick(tracker.tracker_advance)


class Tracked(NamedTuple):
    """The result of `track` for n samples: m ticks (m, 2) of position [m] and speed [m/s] with their stamps (m,) [ns].

    For each sample: the number of ticks so far, its status (a code of `ces_observer.tick.tracker`), and its time after
    the last tick [ticks]. `late` (m, 2) are the ticks as they are known after the sampling's delay, NaN where they
    never are; without a delay, the ticks. `innovations` (n,) [m] are NaN where there is none. `likelihood` is the mean
    log likelihood of the measured ticks.
    """

    ticks: F
    stamps_ns: I
    total: I
    status: NDArray[np.int8]
    ahead: F
    late: F
    innovations: F
    likelihood: float


def track(stamps_ns: I, positions: F, sampling: Sampling, motion: F | None = None) -> Tracked:
    """Return the ticks of n samples; `motion` (n,) is the signal that the sampling names."""
    arrays = layout_of(sampling).arrays()
    p, n, s, k = (np.array(arrays.p), np.array(arrays.n, np.int64), np.array(arrays.s), np.array(arrays.k, np.int64))
    motion = np.zeros(len(stamps_ns)) if motion is None else motion
    return Tracked(*_track(p, n, s, k, stamps_ns, positions, motion, sampling.rate_Hz))


@core_kernel
def _track(numbers: F, counts: I, states: F, flags: I, stamps: I, positions: F, motion: F, rate: float) -> Any:
    """Do the work of `track`, with new arrays of the tick."""
    p, n, s, k = pointer(numbers), pointer(counts), pointer(states), pointer(flags)
    count, delay = len(stamps), n[DELAY]
    room = count + 2
    for i in range(1, count):
        room += int(min(abs(stamps[i] - stamps[i - 1]), (PATIENCE + 2) * n[MAX_GAP_NS]) * rate * 1e-9) + 2
    ticks, times = np.empty((room, 2)), np.empty(room, np.int64)  # unused rows cost nothing
    late = np.empty((room, 2)) if delay > 0 else ticks
    total, status = np.zeros(count, np.int64), np.zeros(count, np.int8)
    ahead, innovations = np.zeros(count), np.empty(count)
    m = measured = 0
    likelihood = 0.0
    for i in range(count):
        s[INNOVATION] = nan
        status[i] = tracker_advance(p, n, s, k, stamps[i], positions[i], motion[i])
        innovations[i] = s[INNOVATION]
        fresh = k[TICKS]
        if status[i] == OK or status[i] == UNSETTLED:
            ahead[i] = s[AHEAD]
            if fresh > 0:
                likelihood += log(s[TOTAL])
                measured += 1
        for j in range(fresh):
            share = (j + 1) / fresh
            ticks[m, 0] = s[OLD_POSITION] + share * (s[BANK_POSITION] - s[OLD_POSITION])
            ticks[m, 1] = s[OLD_SPEED] + share * (s[BANK_SPEED] - s[OLD_SPEED])
            times[m] = k[ORIGIN] + np.int64(floor((k[LAST_TICK] - fresh + 1 + j) * (1e9 / rate) + 0.5))
            if delay > 0:
                late[m, 0] = late[m, 1] = nan
                if k[n[LATE_KNOWN] + j] != 0:
                    late[m - delay, 0], late[m - delay, 1] = s[n[LATE_AT] + 2 * j], s[n[LATE_AT] + 2 * j + 1]
            m += 1
        if fresh > 0:
            ticks[m - 1, 0], ticks[m - 1, 1] = s[BANK_POSITION], s[BANK_SPEED]
        total[i] = m
    return ticks[:m], times[:m], total, status, ahead, late[:m], innovations, likelihood / max(measured, 1)
