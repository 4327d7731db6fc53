"""Faults of single sensors: dead or stuck, held between slow samples, too coarse, clipped.

Coarse and noise-free channels repeat values where nothing is wrong. A stretch of equal values counts only in a channel
whose noise changes the samples elsewhere, or if it begins or ends with a jump that the signal never makes otherwise,
and only while the other signal shows that it should have changed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ces_identify.numerics.arrays import F, I, Mask
from ces_identify.recordings.checks import WARNING, WRONG_MODEL, Finding, mean_rate
from ces_identify.recordings.recording import Channel, Recording
from ces_identify.sense.saturation import find_saturations

MIN_SAMPLES = 1000
MIN_LEVELS = {"position": 100, "force": 50}  # values in the range, below which a quantum is coarse
COARSE_REPEATS = 0.5  # share of samples that repeat the one before; noise larger than the quantum leaves fewer
SAMPLES_A_LEVEL = 10  # from which on the values are those of a converter
SPEED_SPAN_S, SPEED_BAND_HZ, MAX_SPEED_NOISE = 0.05, 50.0, 0.05  # of a model's speed; share that a quantum may disturb
NOISY_REPEATS = 0.3  # share of repeats up to which a channel is noisy, so that a long run of them is a fault
STUCK_S, STUCK_SAMPLES = 0.1, 50
STUCK_CHANGE = {"position": 0.3, "force": 0.1}  # change of the other signal meanwhile, of its range
WRONG_STUCK = 0.02  # share of the time
MAX_VISIT = 0.5  # of the samples at a limit: a single longer visit is a sensor that is stuck there
JUMP = 5.0  # a signal's return from a stuck value, in its largest steps elsewhere
HELD_SAMPLES, HELD_STEPS = 3, 4.0  # repeats of each value, and steps between values in quanta
OTHER = {"position": "force", "force": "position"}


def sensor_findings(recording: Recording) -> Iterator[Finding]:
    """Yield the findings on position and force."""
    channels = {name: _finite(recording.channels[name]) for name in OTHER if name in recording.channels}
    for name, channel in channels.items():
        if len(channel) < MIN_SAMPLES:
            continue
        if np.ptp(channel.values) == 0.0:
            yield from _dead(channel)
            continue
        runs = runs_of_equal(channel.values)
        limits = [s.limit for s in find_saturations(recording, name)]
        stuck = list(_stuck(channel, channels.get(OTHER[name]), runs, limits))
        held = [] if stuck else list(_held(channel, runs))
        yield from stuck or held or _too_coarse(channel, runs)


def _dead(channel: Channel) -> Iterator[Finding]:
    if channel.name == "force":  # `checks` reports a constant position
        yield Finding(
            WRONG_MODEL,
            f"force: constant at {channel.values[0]:g} N; expected a force that changes with the stroke: check topic "
            "and field in the signals file, and the load cell",
            signal="force",
        )


def _stuck(channel: Channel, other: Channel | None, runs: I, limits: Sequence[float]) -> Iterator[Finding]:
    """Yield the stretches in which a noisy channel repeats one value while the other signal changes.

    Those at a limit at which it saturates again and again are no fault of their own.
    """
    lengths = runs[:, 1] - runs[:, 0]
    long = lengths >= max(STUCK_SAMPLES, STUCK_S * mean_rate(channel))
    rest = lengths[~long]
    for limit in limits:
        visits = channel.values[runs[:, 0]] == limit
        if lengths[visits].max() < MAX_VISIT * lengths[visits].sum():
            long &= ~visits
    if other is None or not long.any() or not len(rest):
        return
    noisy = (rest - 1).sum() <= NOISY_REPEATS * rest.sum()
    suspects = runs[long] if noisy else runs[long & _jumps(channel.values, runs)]
    spans = [(int(channel.stamps_ns[a]), int(channel.stamps_ns[b - 1])) for a, b in suspects]
    moved = [span for span in spans if _change(other, *span) > STUCK_CHANGE[channel.name]]
    if not moved:
        return
    total = sum(b - a for a, b in moved) / max(int(np.ptp(channel.stamps_ns)), 1)
    first = (moved[0][0] - int(channel.stamps_ns[0])) * 1e-9
    yield Finding(
        WRONG_MODEL if total > WRONG_STUCK else WARNING,
        f"{channel.name}: stuck {count_times(len(moved))} {first:.2f} s, {total:.1%} of the time, while the "
        f"{other.name} changes; check the sensor and its cable, and cut these stretches out",
        signal=channel.name,
    )


def _jumps(values: F, runs: I) -> Mask:
    """Return for each run (n,) whether the signal jumps to it or from it, as it does nowhere else."""
    steps = np.abs(np.diff(values, prepend=values[:1], append=values[-1:]))  # before each sample, and after the last
    limit = JUMP * float(np.percentile(steps, 99.5))
    return np.asarray(np.maximum(steps[runs[:, 0]], steps[runs[:, 1]]) > limit)


def _held(channel: Channel, runs: I) -> Iterator[Finding]:
    """Yield a finding if a channel repeats each of its samples: it was logged faster than it was measured."""
    steps = np.abs(np.diff(channel.values[runs[:, 0]]))
    lengths = np.diff(runs[:, 0])
    if len(lengths) < 50 or np.median(lengths) < HELD_SAMPLES or np.percentile(lengths, 10) < HELD_SAMPLES - 1:
        return
    if np.median(steps) >= HELD_STEPS * np.percentile(steps, 1):
        rate = mean_rate(channel)
        yield Finding(
            WARNING,
            f"{channel.name}: stamped at {rate:.0f} Hz, but each value is repeated {np.median(lengths):.0f} times: it "
            f"is measured at {rate / np.median(lengths):.0f} Hz; log it at the rate of its sensor, 500 Hz or more",
            signal=channel.name,
        )


def _too_coarse(channel: Channel, runs: I) -> Iterator[Finding]:
    coarse = list(_coarse_position(channel)) if channel.name == "position" else []
    yield from coarse or _coarse(channel, runs)


def _coarse(channel: Channel, runs: I) -> Iterator[Finding]:
    repeats = 1.0 - len(runs) / len(channel)
    low, high = np.percentile(channel.values, (1.0, 99.0))
    inside = channel.values[(channel.values >= low) & (channel.values <= high)]
    levels = len(np.unique(inside))
    if levels < MIN_LEVELS[channel.name] and repeats > COARSE_REPEATS:
        yield Finding(
            WARNING,
            f"{channel.name}: only {levels} values between {low:.4g} and {high:.4g} {channel.unit}: too coarse for a "
            f"{'speed' if channel.name == 'position' else 'model'}; record with more resolution",
            signal=channel.name,
        )


def _coarse_position(channel: Channel) -> Iterator[Finding]:
    """Yield a finding if the position's quantum disturbs the speed: error q / sqrt(12), white up to half the rate."""
    low, high = np.percentile(channel.values, (1.0, 99.0))
    inside = channel.values[(channel.values >= low) & (channel.values <= high)]
    levels = len(np.unique(inside))
    if levels < 2 or len(inside) < SAMPLES_A_LEVEL * levels:
        return
    quantum, rate = float(high - low) / (levels - 1), mean_rate(channel)
    band = min(SPEED_BAND_HZ, 0.5 * rate)
    noise = quantum / np.sqrt(12.0) * 2.0 * np.pi * np.sqrt(2.0 * band**3 / (3.0 * rate))
    speed = _usual_speed(channel)
    if noise > MAX_SPEED_NOISE * speed:
        yield Finding(
            WARNING,
            f"position: its steps of {1e3 * quantum:.2g} mm disturb the speed by {noise:.2g} m/s, {noise / speed:.0%} "
            f"of its usual {speed:.2g} m/s: too coarse; record with more resolution, or with faster strokes",
            signal="position",
        )


def _usual_speed(channel: Channel) -> float:
    """Return the 90th percentile of the speed [m/s] over 50 ms, NaN if all stamps are equal."""
    step = max(1, round(SPEED_SPAN_S * mean_rate(channel)))
    time = (channel.stamps_ns[step:] - channel.stamps_ns[:-step]) * 1e-9
    moved = np.abs(channel.values[step:] - channel.values[:-step])
    return float(np.percentile(moved[time > 0.0] / time[time > 0.0], 90.0)) if (time > 0.0).any() else np.nan


def count_times(count: int) -> str:
    """Return how often, before the time of the first."""
    return "once, at" if count == 1 else f"{count} times, first at"


def runs_of_equal(values: F) -> I:
    """Return begin and end (n, 2) of the runs of equal values."""
    changes = np.flatnonzero(np.diff(values) != 0.0) + 1
    return np.stack([np.concatenate([[0], changes]), np.concatenate([changes, [len(values)]])], axis=1)


def _change(channel: Channel, begin: int, end: int) -> float:
    """Return by how much of its range a channel changes between two stamps."""
    inside: Mask = (channel.stamps_ns >= begin) & (channel.stamps_ns <= end)
    values, whole = channel.values[inside], np.percentile(channel.values, (1.0, 99.0))
    return float(np.ptp(values) / max(np.ptp(whole), 1e-30)) if len(values) else 0.0


def _finite(channel: Channel) -> Channel:
    return channel.select(np.isfinite(channel.values))
