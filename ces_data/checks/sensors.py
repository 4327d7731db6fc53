"""Faults of single sensors: dead or stuck, held between slow samples, too coarse, clipped.

Coarse and noise-free channels repeat values where nothing is wrong. A stretch of equal values counts only in a channel
whose noise changes the samples elsewhere, or if it begins or ends with a jump that the signal never makes otherwise,
and only while the other signal shows that it should have changed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from ces_data.arrays import F, I, Mask
from ces_data.checks.motion import RATE_HZ, RecordedMotion, fit_errors, force_features, is_constant
from ces_data.findings import WARNING, WRONG_MODEL, Finding, SaturationFinding, mean_rate, runs_of_equal
from ces_data.limits import CurrentLimits, DamperLimits, RateLimits, SensorLimits, StatisticLimits
from ces_data.recording import Channel, Recording

SPEED_SPAN_S, SPEED_BAND_HZ = 0.05, 50.0  # of a model's speed
OTHER = {"position": "force", "force": "position"}


def sensor_findings(recording: Recording) -> Iterator[Finding]:
    """Yield the findings on position and force."""
    channels = {name: recording.channels[name].finite() for name in OTHER if name in recording.channels}
    for name, channel in channels.items():
        if len(channel) < SensorLimits.MIN_SAMPLES:
            continue
        if np.ptp(channel.values) == 0.0:
            if name == "force":  # `findings` reports a constant position
                text = "expected a force that changes with the stroke: check topic and field in the signals file, and"
                value = channel.values[0]
                yield Finding(WRONG_MODEL, f"force: constant at {value:g} N; {text} the load cell", "force")
            continue
        runs = runs_of_equal(channel.values)
        limits = [s.limit for s in find_saturations(recording, name)]
        faults = list(_stuck(channel, channels.get(OTHER[name]), runs, limits)) or list(_held(channel, runs))
        yield from faults or _coarse(channel, runs)


def _stuck(channel: Channel, other: Channel | None, runs: I, limits: Sequence[float]) -> Iterator[Finding]:
    """Yield stretches in which a noisy channel repeats a value, not its usual limit, while the other changes."""
    lengths = np.diff(runs, axis=1)[:, 0]
    fine = channel.name == "force" and 1.0 - len(runs) / len(channel) <= SensorLimits.FINE_REPEATS
    long, noisy = _long_runs(
        channel,
        runs,
        *((SensorLimits.FINE_S, SensorLimits.FINE_SAMPLES) if fine else (SensorLimits.STUCK_S, StatisticLimits.ENOUGH)),
    )
    if other is None or noisy is None:
        return
    for limit in limits:
        visits = channel.values[runs[:, 0]] == limit
        if lengths[visits].max() < SensorLimits.MAX_VISIT * lengths[visits].sum():
            long &= ~visits
    unusual = (
        lengths > SensorLimits.UNUSUAL * max(lengths[~long].max(), 1)
        if channel.name == "force"
        else np.zeros(len(runs), bool)
    )
    suspects = runs[long] if noisy else runs[long & (unusual | _jumps(channel.values, runs))]
    spans = [(int(channel.stamps_ns[a + 1]), int(channel.stamps_ns[b - 2])) for a, b in suspects]
    moved = [span for span in spans if _change(other, *span) > SensorLimits.STUCK_CHANGE[channel.name]]
    if not moved:
        return
    total = sum(b - a for a, b in moved) / max(int(np.ptp(channel.stamps_ns)), 1)
    first = (moved[0][0] - int(channel.stamps_ns[0])) * 1e-9
    times = f"{count_times(len(moved))} {first:.2f} s, {total:.1%} of the time"
    severity = WRONG_MODEL if total > SensorLimits.WRONG_SHARE else WARNING
    yield Finding(severity, f"{channel.name}: stuck {times}, while the {other.name} changes; {REMEDY}", channel.name)


def _long_runs(
    channel: Channel, runs: I, seconds: float, samples: int = StatisticLimits.ENOUGH
) -> tuple[Mask, bool | None]:
    """Return which runs of equal values are long; and whether the channel is noisy otherwise, None if unknown."""
    lengths = np.diff(runs, axis=1)[:, 0]
    long = lengths >= max(samples, seconds * mean_rate(channel))
    short = lengths[~long]
    known = long.any() and len(short) > 0
    return long, bool((short - 1).sum() <= SensorLimits.NOISY_REPEATS * short.sum()) if known else None


def _jumps(values: F, runs: I) -> Mask:
    """Return for each run (n,) whether the signal jumps to it or from it, as it does nowhere else."""
    steps = np.abs(np.diff(values, prepend=values[:1], append=values[-1:]))  # before each sample, and after the last
    limit = SensorLimits.JUMP * float(np.percentile(steps, 99.5))
    return np.asarray(np.maximum(steps[runs[:, 0]], steps[runs[:, 1]]) > limit)


def _held(channel: Channel, runs: I) -> Iterator[Finding]:
    """Yield a finding if a channel repeats each of its samples: it was logged faster than it was measured."""
    steps = np.abs(np.diff(channel.values[runs[:, 0]]))
    lengths = np.diff(runs[:, 0])
    if (
        len(lengths) < StatisticLimits.ENOUGH
        or np.median(lengths) < SensorLimits.HELD_SAMPLES
        or np.percentile(lengths, 10) < SensorLimits.HELD_SAMPLES - 1
    ):
        return
    if np.median(steps) >= SensorLimits.HELD_STEPS * np.percentile(steps, 1):
        rate, times = mean_rate(channel), np.median(lengths)
        text = (
            f"{channel.name}: stamped at {rate:.0f} Hz, but each value is repeated {times:.0f} times: it is measured "
            f"at {rate / times:.0f} Hz; log it at the rate of its sensor, 500 Hz or more"
        )
        yield Finding(WARNING, text, channel.name)


def _coarse(channel: Channel, runs: I) -> Iterator[Finding]:
    """Yield a finding if a channel has too few values, or the position's quantum disturbs the speed."""
    low, high = np.percentile(channel.values, (1.0, 99.0))
    inside = channel.values[(channel.values >= low) & (channel.values <= high)]
    levels, repeats = len(np.unique(inside)), 1.0 - len(runs) / len(channel)
    disturbance = ""
    if channel.name == "position" and levels >= 2 and len(inside) >= SensorLimits.SAMPLES_A_LEVEL * levels:
        disturbance = _describe_disturbance(channel, float(high - low) / (levels - 1))
    if disturbance:
        yield Finding(WARNING, disturbance, "position")
    elif levels < SensorLimits.MIN_LEVELS[channel.name] and repeats > SensorLimits.COARSE_REPEATS:
        text = f"{channel.name}: only {levels} values between {low:.4g} and {high:.4g} {channel.unit}: too coarse for a"
        what = "speed" if channel.name == "position" else "model"
        yield Finding(WARNING, f"{text} {what}; record with more resolution", channel.name)


def _describe_disturbance(channel: Channel, quantum: float) -> str:
    """Return how far a position's quantum [m] disturbs the speed: error q / sqrt(12), white up to half the rate."""
    rate = mean_rate(channel)
    band = min(SPEED_BAND_HZ, 0.5 * rate)
    noise = quantum / np.sqrt(12.0) * 2.0 * np.pi * np.sqrt(2.0 * band**3 / (3.0 * rate))
    step = max(1, round(SPEED_SPAN_S * rate))
    time = (channel.stamps_ns[step:] - channel.stamps_ns[:-step]) * 1e-9
    moved = np.abs(channel.values[step:] - channel.values[:-step])[time > 0.0] / time[time > 0.0]
    speed = float(np.percentile(moved, 90.0)) if len(moved) else np.nan  # the usual one, over 50 ms
    if not noise > SensorLimits.MAX_SPEED_NOISE * speed:
        return ""
    return (
        f"position: its steps of {1e3 * quantum:.2g} mm disturb the speed by {noise:.2g} m/s, {noise / speed:.0%} "
        f"of its usual {speed:.2g} m/s: too coarse; record with more resolution, or with faster strokes"
    )


def count_times(count: int) -> str:
    """Return how often, before the time of the first."""
    return "once, at" if count == 1 else f"{count} times, first at"


def _change(channel: Channel, begin: int, end: int) -> float:
    """Return by how much of its range a channel changes between two stamps."""
    inside: Mask = (channel.stamps_ns >= begin) & (channel.stamps_ns <= end)
    values, whole = channel.values[inside], np.percentile(channel.values, (1.0, 99.0))
    return float(np.ptp(values) / max(np.ptp(whole), 1e-30)) if len(values) else 0.0


SATURATES = "the channel saturates"
REMEDIES = {"force": "record with a larger range", "position": "move the sensor's range to that of the stroke"}


@dataclass(frozen=True)
class Saturation:
    """The value [N or m] at which a channel saturates, and the share of its samples at this limit."""

    limit: float
    share: float


def find_saturations(recording: Recording, signal: str = "force") -> tuple[Saturation, ...]:
    """Return the limits at which the force, or the position, saturates, lowest first; empty if it does not.

    Samples accumulate at a limit. A force that only reverses there leaves about as many samples on the neighbouring
    values, even with a coarse converter.
    """
    channel = recording.channel(signal)
    values, counts = np.unique(channel.values[np.isfinite(channel.values)], return_counts=True)
    if len(values) < 2 * SensorLimits.NEIGHBOURS:
        return ()
    total = int(counts.sum())
    ends = ((values, counts), (values[::-1], counts[::-1]))
    return tuple(
        Saturation(float(v[0]), float(c[0]) / total)
        for v, c in ends
        if c[0] >= max(SensorLimits.MIN_AT_LIMIT, SensorLimits.MIN_SHARE * total)
        and c[0] >= SensorLimits.MIN_PEAK_RATIO * c[1 : SensorLimits.NEIGHBOURS + 1].max()
        and (signal == "force" or _arrives_fast(channel, float(v[0])))
    )


def _arrives_fast(channel: Channel, limit: float) -> bool:
    """Return whether the position runs into a limit instead of coming to rest there, as a piston does."""
    values = channel.values
    back = max(1, round(SensorLimits.ARRIVAL_S * mean_rate(channel)))
    steps = np.abs(values[back:] - values[:-back])
    arrivals = np.flatnonzero((values[1:] == limit) & (values[:-1] != limit)) - back
    if (values == limit).sum() < SensorLimits.MIN_STAY * len(
        arrivals
    ):  # a noise-free sine touches its largest value only
        return False
    arrivals = arrivals[arrivals >= 0]
    usual = float(np.sqrt(np.nanmean(steps**2)))
    return bool(len(arrivals)) and float(np.nanmedian(steps[arrivals])) > SensorLimits.ARRIVAL_SPEED * usual


def saturation_findings(recording: Recording) -> Iterator[Finding]:
    """Yield a finding for the force and for the position if it saturates."""
    for signal, remedy in REMEDIES.items():
        limits = find_saturations(recording, signal) if signal in recording.channels else ()
        if limits:
            severity = WRONG_MODEL if sum(limit.share for limit in limits) > SensorLimits.WRONG_SHARE else WARNING
            what = describe_saturations(limits, recording.channel(signal).unit)
            yield SaturationFinding(severity, f"{signal}: {SATURATES}: {what}; {remedy}", signal)


def describe_saturations(limits: tuple[Saturation, ...], unit: str = "N") -> str:
    """Return the limits and their shares as text."""
    return " and ".join(f"{s.share:.1%} of the samples at {s.limit:.5g} {unit}" for s in limits)


MAX_STRETCHES = 3  # of one current that are looked at, the longest
REMEDY = "check the sensor and its cable, and cut these stretches out"


def current_findings(recording: Recording, motion: RecordedMotion | None) -> Iterator[Finding]:
    """Yield a finding if the recorded current stands still while the force, or its own noise, shows a fault."""
    channel = recording.channels.get("current")
    if channel is not None:
        by_force = _unlike_force(motion) if motion is not None and not is_constant(motion.current) else None
        yield from [by_force] if by_force else _without_noise(channel.finite())


def _unlike_force(motion: RecordedMotion) -> Finding | None:
    """Return a finding on the first stretch of one current in which the force changes as if the current moved."""
    runs = runs_of_equal(motion.current)
    lengths = runs[:, 1] - runs[:, 0]
    longest = np.argsort(-lengths, kind="stable")[:MAX_STRETCHES]
    for begin, end in runs[longest][lengths[longest] >= CurrentLimits.MIN_STRETCH_S * RATE_HZ]:
        others = np.concatenate([np.arange(begin), np.arange(end, len(motion))])
        if len(others) < CurrentLimits.MIN_REST * len(motion):
            continue
        inside, outside = (
            _error(motion, np.arange(begin + round(CurrentLimits.SETTLING_S * RATE_HZ), end)),
            _error(motion, others),
        )
        if inside > max(CurrentLimits.RATIO * outside, CurrentLimits.MIN_ERROR):
            share = (end - begin) / len(motion)
            text = (
                f"current: stuck at {motion.current[begin]:.3g} A for {(end - begin) / RATE_HZ:.1f} s, {share:.0%} of "
                f"the time, while the force changes as if it moved ({inside:.0%} of it does not follow the motion, "
                f"{outside:.0%} elsewhere); {REMEDY}"
            )
            return Finding(WRONG_MODEL if share > SensorLimits.WRONG_SHARE else WARNING, text, "current")
    return None


def _without_noise(channel: Channel) -> Iterator[Finding]:
    """Yield the stretches in which a current whose noise changes it everywhere else repeats one value."""
    if len(channel) < SensorLimits.MIN_SAMPLES or np.ptp(channel.values) == 0.0:
        return
    runs = runs_of_equal(channel.values)
    long, noisy = _long_runs(channel, runs, SensorLimits.STUCK_CURRENT_S)
    total = np.diff(runs[long], axis=1).sum() / len(channel)
    if noisy and total < SensorLimits.MAX_STUCK_CURRENT:
        first = (channel.stamps_ns[int(runs[long][0, 0])] - channel.stamps_ns[0]) * 1e-9
        when = f"{count_times(int(long.sum()))} {first:.2f} s, {total:.1%} of the time"
        yield Finding(WARNING, f"current: stuck {when}, although noise changes it everywhere else; {REMEDY}", "current")


def _error(motion: RecordedMotion, ticks: I) -> float:
    """Return the relative error of the map from motion and current to the force on these ticks; 0 if little moves."""
    signals = {name: getattr(motion, name)[ticks] for name in ("position", "speed", "force", "current")}
    part = replace(motion, **signals, parts=())
    if part.speed.std() < CurrentLimits.MIN_MOTION * motion.speed.std() or part.force.std() == 0.0:
        return 0.0
    return float(fit_errors(force_features(part).T, part.force[:, None])[0])


SIDE = 3  # samples on each side that must have no gap between them


def rate_findings(recording: Recording) -> Iterator[Finding]:
    """Yield a finding if the rate is too low for the force, or else for the response of the valve."""
    force, current = recording.channels.get("force"), recording.channels.get("current")
    rate = mean_rate(force) if force is not None else 0.0
    if force is None or not DamperLimits.MIN_RATE_HZ < rate < RateLimits.MAX_CHECKED_HZ:
        return
    miss = interpolation_miss(force)
    if miss > RateLimits.MISS:
        text = (
            f"force: changes too fast for {rate:.0f} Hz: half of its samples, interpolated from the others, miss by "
            f"{miss:.0%} of its RMS, and a model will err by a third to half of that; oil and valves change a force "
            "within 5 to 30 ms: record at 500 Hz or more"
        )
        yield Finding(WRONG_MODEL if miss > RateLimits.WRONG_MISS else WARNING, text, "force")
    elif rate < RateLimits.MIN_VALVE_HZ and current is not None and not is_constant(current.finite().values):
        text = (
            f"force: {rate:.0f} Hz is too low for the response of a valve, 5 to 30 ms: a model cannot learn how the "
            "force follows the current; record at 500 Hz or more"
        )
        yield Finding(WARNING, text, "force")


def interpolation_miss(channel: Channel) -> float:
    """Return the relative RMS error of every second sample, interpolated, gaps apart; NaN if constant or few."""
    sound = channel.in_order()
    stamps, values = sound.stamps_ns, sound.values
    if len(values) < StatisticLimits.MANY or np.ptp(values) == 0.0:
        return np.nan
    time = (stamps - stamps[0]) * 1e-9
    odd = np.arange(SIDE, len(time) - SIDE, 2)  # SIDE is odd
    odd = odd[time[odd + SIDE] - time[odd - SIDE] < 4.0 * SIDE * float(np.median(np.diff(time)))]
    if len(odd) < StatisticLimits.MANY // 4:
        return np.nan
    errors = CubicSpline(time[::2], values[::2])(time[odd]) - values[odd]
    return float(np.sqrt(np.mean(errors**2)) / values.std())
