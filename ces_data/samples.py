"""The samples of channels: statistics as logged, holes, spikes, the time at each speed and current."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.signal import butter, detrend, savgol_filter, sosfiltfilt

from ces_data.arrays import F, I, Mask
from ces_data.findings import SECOND, mean_rate, runs_of_equal
from ces_data.limits import LossLimits, RatingLimits, RecordingLimits, StatisticLimits
from ces_data.recording import Channel, Recording, Stamps
from ces_observer.errors import RecordingError
from ces_observer.signals import Constant, FieldPath, Signal


@dataclass(frozen=True)
class ChannelStats:
    """Statistics of one channel; NaN where it has too few samples.

    `jitter_s` is the standard deviation of the intervals without gaps, `longest_s` the longest interval; `low` and
    `high` are the range of the finite values in the channel's unit.
    """

    count: int
    duration_s: float
    rate_Hz: float
    jitter_s: float
    longest_s: float
    gaps: int
    low: float
    high: float


def channel_stats(channel: Channel) -> ChannelStats:
    """Return the statistics of a channel, its stamps sorted first."""
    intervals_ns = np.diff(np.sort(channel.stamps_ns))
    usual_ns = float(np.median(intervals_ns)) if len(intervals_ns) else 0.0
    gaps = intervals_ns.astype(np.float64) > RecordingLimits.GAP_INTERVALS * usual_ns
    values = channel.values[np.isfinite(channel.values)]
    return ChannelStats(
        count=len(channel),
        duration_s=float(intervals_ns.sum() / SECOND),
        rate_Hz=mean_rate(channel),
        jitter_s=float(intervals_ns[~gaps].std() / SECOND) if len(intervals_ns) else np.nan,
        longest_s=float(intervals_ns.max() / SECOND) if len(intervals_ns) else np.nan,
        gaps=int(gaps.sum()),
        low=float(values.min()) if len(values) else np.nan,
        high=float(values.max()) if len(values) else np.nan,
    )


def measured_at(channel: Channel, stamps_ns: Stamps) -> NDArray[np.bool_]:
    """Return where a channel was measured (n,): at its finite samples, and between two of them without a hole.

    A hole is an interval between finite samples that is longer than 1.75 usual ones (the 90th percentile), or that
    holds a sample that is not finite, unless most do, as in tables whose rows are denser than the measurement.
    """
    finite = np.flatnonzero(np.isfinite(channel.values))
    if len(finite) < 2:
        return np.zeros(len(stamps_ns), bool)
    logged = channel.stamps_ns[finite]
    interval, skips = np.diff(logged), np.diff(finite) > 1
    hole = interval > RecordingLimits.MAX_INTERVAL * np.percentile(interval, 90.0)
    if skips.mean() < 0.5:
        hole |= skips
    after = np.clip(np.searchsorted(logged, stamps_ns), 1, len(logged) - 1)
    inside = (stamps_ns >= logged[0]) & (stamps_ns <= logged[-1])
    return np.asarray(inside & (~hole[after - 1] | (stamps_ns == logged[after]) | (stamps_ns == logged[after - 1])))


def find_spikes(channel: Channel) -> Mask:
    """Return which samples (n,) of a position, current or force no sensor can have measured.

    A spike has up to three samples within 5 ms, far from the median of twice as many around it. A burst of up to 10
    ms begins with a jump and ends with the opposite one. Both are judged by the signal's own span and by its other
    steps, so that pulses that occur more often, or that rise in several samples, are none.
    """
    spikes, finite = np.zeros(len(channel), bool), np.flatnonzero(np.isfinite(channel.values))
    rate = mean_rate(channel)
    length = min(round(LossLimits.SPIKE_S * rate), LossLimits.MAX_SPIKE)
    if channel.name not in LossLimits.JUMP_SPANS or len(finite) < StatisticLimits.ENOUGH or not length:
        return spikes
    values = channel.values[finite]
    usual = median_filter(values, 2 * length + 1, mode="nearest")
    distance, span = np.abs(values - usual), float(np.ptp(np.percentile(usual, (0.5, 99.5))))
    least = LossLimits.JUMP_SPANS[channel.name] * max(span, LossLimits.MIN_SPANS[channel.name])
    far = distance > max(least, LossLimits.SPIKE_RATIO * float(np.percentile(distance, 95.0)))
    if channel.name != "current":
        others = np.flatnonzero(~far)
        far[others] = _find_bursts(values[others], LossLimits.BURST * least, LossLimits.BURST_S * rate)
    spikes[finite] = far
    return spikes


def find_jumps(values: F, least: float) -> I:
    """Return the indices before jumps: steps of more than `least` that exceed by far nearly all others."""
    steps = np.abs(np.diff(values))
    moves = steps[steps > 0.0]
    usual = float(np.percentile(moves, 95.0)) if len(moves) else 0.0
    return np.flatnonzero(steps > max(least, LossLimits.STEP_RATIO * usual))


def _find_bursts(values: F, least: float, longest: float) -> Mask:
    """Return which samples (n,) lie between a jump and another that leads back, at most `longest` samples later."""
    jumps, inside = find_jumps(values, least), np.zeros(len(values), bool)
    for k, begin in enumerate(jumps):
        back = [j for j in jumps[k + 1 :][: LossLimits.MAX_SPIKE] if abs(values[j + 1] - values[begin]) < least]
        if not inside[begin] and back and back[0] - begin <= longest:
            inside[begin + 1 : back[0] + 1] = True
    return inside


def find_dropouts(channel: Channel, other: Channel | None) -> Mask:
    """Return which samples (n,) repeat one value after a jump, or up to one, while `other` moves: of a lost sensor.

    A current that repeats its values elsewhere, too, as a commanded one, has none.
    """
    dropouts, finite = np.zeros(len(channel), bool), np.flatnonzero(np.isfinite(channel.values))
    if (
        channel.name not in LossLimits.DROPOUT_SPANS
        or other is None
        or min(len(finite), len(other)) < StatisticLimits.ENOUGH
    ):
        return dropouts
    values = channel.values[finite]
    runs = runs_of_equal(values)
    if channel.name == "current" and 1.0 - len(runs) / len(values) > LossLimits.MAX_REPEATS:
        return dropouts
    jumps = find_jumps(
        values, LossLimits.DROPOUT_SPANS[channel.name] * float(np.ptp(np.percentile(values, (0.5, 99.5))))
    )
    long = runs[np.diff(runs, axis=1)[:, 0] >= LossLimits.MIN_DROPOUT]
    moved = LossLimits.MIN_MOVE * float(np.ptp(np.percentile(other.values, (0.5, 99.5))))
    for begin, end in long[np.isin(long - 1, jumps).any(axis=1)]:
        a, b = np.searchsorted(other.stamps_ns, channel.stamps_ns[finite[[begin + 1, end - 2]]])
        if np.ptp(other.values[a : b + 1]) > moved:
            dropouts[finite[begin:end]] = True
    return dropouts


def mask_lost(recording: Recording, name: str, dropouts: bool = True) -> Channel:
    """Return a channel with NaN in the place of spikes and, if wanted, `dropouts`: they count as not measured."""
    channel = recording.channels[name]
    other = recording.channels.get("force" if name == "position" else "position")
    moving = None if other is None else other.finite()
    for find in (find_spikes, lambda logged: find_dropouts(logged, moving))[: 1 + dropouts]:
        if (lost := find(channel)).any():
            channel = replace(channel, values=np.where(lost, np.nan, channel.values))
    return channel


def without_spikes(recording: Recording, split: float = 1.0, dropouts: bool = True) -> Recording:
    """Return the recording with all channels as `mask_lost`; its parts before and after `split` are judged alone."""
    parts = [recording] if split >= 1.0 else [recording.share(0.0, split), recording.share(split, 1.0)]
    cleaned = [replace(p, channels={name: mask_lost(p, name, dropouts) for name in p.channels}) for p in parts]
    return Recording.join(cleaned)


SPIKE_PASSES = 5  # for spikes so close together that they hide each other


def is_rough(values: F) -> bool:
    """Return whether samples (n,) jump about like noise instead of moving like a stroke."""
    spread = float(values.std()) if len(values) > 1 else 0.0
    return spread > 0.0 and float(np.sqrt(np.mean(np.diff(values) ** 2))) > RatingLimits.ROUGH * spread


def remove_spikes(position: F) -> F:
    """Return `position` with spikes of up to three samples replaced by interpolation.

    A spike is far from the parabola through the three samples before it and from that through the three after.
    """
    low, high = np.percentile(position, (1.0, 99.0))
    places, good, clean = np.arange(len(position)), np.ones(len(position), bool), position
    for _ in range(SPIKE_PASSES):
        distance = _parabola_distance(clean)
        spikes = distance > max(LossLimits.OUTLIER * 1.4826 * float(np.median(distance)), 0.002 * (high - low))
        if not spikes.any():
            break
        good &= ~spikes
        clean = np.asarray(np.interp(places, places[good], position[good]))
    return clean


def _parabola_distance(x: F) -> F:
    """Return distances (n,) to the nearer of the parabolas through the three samples before and the three after."""
    before, after = np.full(len(x), np.inf), np.full(len(x), np.inf)
    before[3:] = abs(x[3:] - (3.0 * x[2:-1] - 3.0 * x[1:-2] + x[:-3]))
    after[:-3] = abs(x[:-3] - (3.0 * x[1:-2] - 3.0 * x[2:-1] + x[3:]))
    return np.asarray(np.minimum(before, after))


WINDOW_S = 0.02  # of the Savitzky-Golay filter, but at least MIN_SAMPLES samples
MIN_SAMPLES = 7
RANGE_QUANTILE = 0.995  # of |speed|; higher speeds count in the outermost cells, so that spikes do not set the scale


@dataclass(frozen=True)
class Coverage:
    """Share of time in each cell of speed and current.

    `speed_edges` (m + 1,) [m/s] and `current_edges` (n + 1,) [A] bound the cells; `share` (n, m) sums to 1, or to 0
    without samples. `duration_s` is the time counted.
    """

    speed_edges: F
    current_edges: F
    share: F
    duration_s: float


def coverage(recordings: Sequence[Recording], speed_cells: int = 24, current_cells: int = 8) -> Coverage:
    """Count the time of recordings with position and current in cells of speed and current."""
    samples = [speed_current_samples(recording) for recording in recordings]
    speed, current, weight = (np.concatenate(parts) for parts in zip(*samples, strict=True))
    top = float(np.quantile(np.abs(speed), RANGE_QUANTILE)) if len(speed) else 0.0
    speed_edges = np.linspace(-1.0, 1.0, speed_cells + 1) * (top or 1.0)
    low, high = (float(current.min()), float(current.max())) if len(current) else (0.0, 0.0)
    single = high - low < 1e-9 * max(1.0, abs(high))
    current_edges = np.array([low - 0.05, high + 0.05]) if single else np.linspace(low, high, current_cells + 1)
    inside = np.clip(speed, speed_edges[0], speed_edges[-1])
    time, _, _ = np.histogram2d(current, inside, [current_edges, speed_edges], weights=weight)
    total = float(weight.sum())
    return Coverage(speed_edges, current_edges, time / total if total else time, total)


def speed_current_samples(recording: Recording) -> tuple[F, F, F]:
    """Return speed [m/s], current [A] and duration [s] of each sample (n,) where both are known.

    The speed is on a regular grid within each run of position without a gap; the current is the last one logged.
    """
    times, speed, interval = _estimate_speed(recording.channel("position"))
    if "current" in recording.constants:
        current = np.full(len(times), recording.constants["current"])
    else:
        channel = recording.channel("current")
        order = np.argsort(channel.stamps_ns, kind="stable")
        last = np.searchsorted(channel.stamps_ns[order], times, side="right") - 1
        current = np.append(channel.values[order], np.nan)[last]  # NaN before the first
    is_known = np.isfinite(current) & np.isfinite(speed)
    return speed[is_known], current[is_known], np.full(int(is_known.sum()), interval / SECOND)


def _estimate_speed(position: Channel) -> tuple[I, F, int]:
    """Return the stamps [ns] and speed of all ticks, and their interval [ns]."""
    sound = position.in_order()
    intervals = np.diff(sound.stamps_ns)
    interval = max(1, int(np.median(intervals))) if len(intervals) else 1
    breaks = np.flatnonzero(intervals > RecordingLimits.GAP_INTERVALS * interval) + 1
    times, speed = [np.empty(0, np.int64)], [np.empty(0)]
    for stamps, x in zip(np.split(sound.stamps_ns, breaks), np.split(sound.values, breaks), strict=True):
        if not len(stamps) or stamps[-1] - stamps[0] < MIN_SAMPLES * interval:
            continue
        grid = np.arange(stamps[0], stamps[-1] + 1, interval)
        even = np.interp((grid - stamps[0]).astype(np.float64), (stamps - stamps[0]).astype(np.float64), x)
        usual = max(MIN_SAMPLES, 2 * round(WINDOW_S * SECOND / interval / 2) + 1)
        window = min(usual, (len(grid) - 1) // 2 * 2 + 1)
        times.append(grid)
        speed.append(savgol_filter(even, window, polyorder=2, deriv=1, delta=interval / SECOND))
    return np.concatenate(times), np.concatenate(speed), interval


CORNER_HZ = 0.1  # of the high-pass; Keio's last 2.5 s alone: RMS 0.2 mm from their stroke within 10 s, of 22 mm
MIN_SPEEDS = 20
INTEGRATED = (
    f"position: none was measured; it is the integral of the speed, without a straight line and below {CORNER_HZ:g} Hz"
)


def with_stroke(recording: Recording) -> Recording:
    """Return the recording with a position: the integral [m] of its speed [m/s] without a straight line and what
    is below the corner, without phase shift.

    Raises RecordingError if it has too few samples, or if its times do not go forward.
    """
    speed = recording.channel("speed").finite()
    steps_s = np.diff(speed.stamps_ns) * 1e-9
    if len(speed) < MIN_SPEEDS or steps_s.min() < 0.0:
        expected = f"expected {MIN_SPEEDS} or more in the order of time, to integrate the speed"
        raise RecordingError(f"{recording.source or recording.name}: {len(speed)} samples of the speed; {expected}")
    means = 0.5 * (speed.values[1:] + speed.values[:-1])
    stroke = np.concatenate([[0.0], np.cumsum(means * steps_s)])
    rate = 1.0 / steps_s.mean()  # rows of a log are nearly even
    high_pass = butter(2, CORNER_HZ, "high", fs=rate, output="sos")
    beyond = min(len(stroke) - 1, round(rate / CORNER_HZ))  # the ends are mirrored, so that they make no step
    values = sosfiltfilt(high_pass, detrend(stroke), padtype="even", padlen=beyond)
    position = Channel("position", "m", speed.stamps_ns, values)
    channels = {"position": position, **recording.channels, "speed": speed}
    return replace(recording, channels=channels, optional=frozenset())


def velocity_beside(position: Signal | Constant) -> Signal | None:
    """Return the speed in the messages of a position in a JointState: `velocity[...]`; None for other positions."""
    name, _, joint = position.field.text.partition("[") if isinstance(position, Signal) else ("", "", "")
    if not isinstance(position, Signal) or (position.type, name) != ("sensor_msgs/msg/JointState", "position"):
        return None
    return replace(position, name="speed", field=FieldPath.parse(f"velocity[{joint}"))


def align_speed(block: Recording) -> Recording:
    """Return a block whose speed has the stamps of the position, in whose messages it is written."""
    speed, position = block.channels.get("speed"), block.channels["position"]
    if speed is None or np.array_equal(speed.stamps_ns, position.stamps_ns):
        return block
    logged = speed.in_order()
    outside = (position.stamps_ns < logged.stamps_ns[0]) | (position.stamps_ns > logged.stamps_ns[-1])
    values = np.where(outside, np.nan, np.interp(position.stamps_ns, logged.stamps_ns, logged.values))
    moved = replace(speed, stamps_ns=position.stamps_ns, values=values)
    return replace(block, channels={**block.channels, "speed": moved})
