"""The motion of a recording on uniform ticks, filtered without delay, for the checks.

Position, force and current are interpolated over the longest stretch without a gap. Position and force pass the same
zero-phase low-pass, so that their relation in time stays as logged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import butter, lfilter, sosfiltfilt

from ces_data.arrays import F, I
from ces_data.limits import DamperLimits, DelayLimits
from ces_data.recording import Channel, Recording
from ces_data.samples import remove_spikes

RATE_HZ = 500.0  # of the ticks
BAND_HZ = 50.0  # of the low-pass, or 0.4 of the lowest sampling rate
MIN_S, MAX_S = 2.0, 60.0  # of the stretch; of a longer one, the part with the fastest motion
GAP_S, GAP_INTERVALS = 0.05, 10.0


@dataclass(frozen=True)
class RecordedMotion:
    """Position [m], speed [m/s], force [N] and current [A], each (n,), on ticks of RATE_HZ.

    `sampled_Hz` is the lower rate of position and force. Without a current it is zero. `parts` are the numbers of
    ticks of the recordings that were joined, one after another; empty for a single one.
    """

    position: F
    speed: F
    force: F
    current: F
    sampled_Hz: float
    parts: tuple[int, ...] = ()

    def __len__(self) -> int:
        return len(self.position)

    def inner_ticks(self, before: int, after: int) -> I:
        """Return the indices of ticks that stay in their recording when moved back and ahead by so many ticks."""
        lengths = np.array(self.parts or (len(self),))
        begins = np.cumsum(lengths) - lengths
        ranges = [np.arange(a + before, a + n - after) for a, n in zip(begins, lengths, strict=True)]
        return np.concatenate(ranges)


def join_motions(motions: Sequence[RecordedMotion]) -> RecordedMotion:
    """Return one motion with the first part of each, about MAX_S seconds together."""
    most = max(round(MAX_S * RATE_HZ) // len(motions), round(MIN_S * RATE_HZ))
    position, speed, force, current = (
        np.concatenate([getattr(motion, name)[:most] for motion in motions])
        for name in ("position", "speed", "force", "current")
    )
    parts = tuple(min(len(motion), most) for motion in motions)
    return RecordedMotion(position, speed, force, current, min(motion.sampled_Hz for motion in motions), parts)


def recorded_motion(recording: Recording) -> RecordedMotion | None:
    """Return the motion of a recording; None if it lacks position or force, or two seconds without a gap."""
    channels = [_usable(recording, name) for name in ("position", "force")]
    spans = _common_spans(channels) if min(map(len, channels)) >= 20 else np.empty((0, 2), np.int64)
    if not len(spans):
        return None
    begin, end = (int(edge) for edge in spans[np.argmax(spans[:, 1] - spans[:, 0])])
    seconds = (end - begin) * 1e-9
    sampled_Hz = min(_count(channel, begin, end) for channel in channels) / max(seconds, 1e-9)
    if seconds < MIN_S or sampled_Hz < DamperLimits.MIN_RATE_HZ:
        return None
    finer = max(1, int(sampled_Hz // RATE_HZ))
    rate = RATE_HZ * finer
    time = np.arange(0.0, seconds, 1.0 / rate)
    low_pass = butter(4, min(BAND_HZ, 0.4 * sampled_Hz), fs=rate, output="sos")
    position, force = (sosfiltfilt(low_pass, _at(channel, begin, time)) for channel in channels)
    speed = np.gradient(position) * rate
    current = _usable(recording, "current")
    held = _at(current, begin, time) if len(current) else np.zeros(len(time))
    part = _fastest_part(speed[::finer])
    x, v, f, i = (np.ascontiguousarray(signal[::finer][part]) for signal in (position, speed, force, held))
    return RecordedMotion(x, v, f, i, sampled_Hz)


def _usable(recording: Recording, name: str) -> Channel:
    """Return the finite samples in time order, each stamp once; without spikes if it is the position."""
    channel = recording.channels.get(name)
    if channel is None:
        return Channel(name, "", np.empty(0, np.int64), np.empty(0))
    channel = channel.in_order()
    if name == "position" and len(channel) > 6:
        return replace(channel, values=remove_spikes(channel.values))
    return channel


def _common_spans(channels: list[Channel]) -> I:
    """Return begin and end [ns] (n, 2) of the stretches in which no channel has a gap."""
    begin = max(int(c.stamps_ns[0]) for c in channels)
    end = min(int(c.stamps_ns[-1]) for c in channels)
    if begin >= end:
        return np.empty((0, 2), np.int64)
    edges = [begin, end]
    for stamps in (c.stamps_ns for c in channels):
        steps = np.diff(stamps)
        wide = np.flatnonzero(steps > max(GAP_S * 1e9, GAP_INTERVALS * float(np.median(steps))))
        edges += [*stamps[wide].tolist(), *stamps[wide + 1].tolist()]
    inner = np.unique(np.clip(np.array(edges, np.int64), begin, end))
    spans = np.stack([inner[:-1], inner[1:]], axis=1)
    filled = [all(_count(c, *span) > 10 for c in channels) for span in spans]
    return np.asarray(spans[np.array(filled, bool)])


def _count(channel: Channel, begin: int, end: int) -> int:
    """Return the number of samples between two stamps."""
    return int(np.ptp(np.searchsorted(channel.stamps_ns, (begin, end))))


def _at(channel: Channel, begin: int, time_s: F) -> F:
    return np.asarray(np.interp(time_s, (channel.stamps_ns - begin) * 1e-9, channel.values))


def _fastest_part(speed: F) -> slice:
    count = round(MAX_S * RATE_HZ)
    if len(speed) <= count:
        return slice(None)
    energy = np.concatenate([[0.0], np.cumsum(speed**2)])
    first = int(np.argmax(energy[count:] - energy[:-count]))
    return slice(first, first + count)


KNOTS = (0.0, 0.02, 0.1, 0.25, 0.4, 0.5, 0.6, 0.75, 0.9, 0.98, 1.0)  # quantiles of the speed
COARSE_KNOTS = (0.0, 0.25, 0.5, 0.75, 1.0)
LAGS_S = (0.0, 0.003, 0.008)  # memory of the force
VALVE_LAGS_S = (0.0, 0.01, 0.025)
RIDGE = 1e-5


def force_features(motion: RecordedMotion) -> F:
    """Return features (k, n): a map of speed and current, also behind lags, and the position."""
    speeds, factors = hats(motion.speed, KNOTS), [np.ones(len(motion))]
    if not is_constant(motion.current):
        n = normalize(motion.current)
        factors += [n, n**2, *(lag(n, seconds) for seconds in VALVE_LAGS_S[1:])]
    base = np.concatenate([speeds * factor for factor in factors])
    return np.concatenate([*(lag(base, seconds) for seconds in LAGS_S), normalize(motion.position)[None]])


ACCELERATION_HZ = (12.0, 25.0, BAND_HZ)
SLOW_VALVE_LAGS_S = (0.05, 0.12)
INERTIA, SPRING, SLOW_VALVE = "inertia", "position", "valve"


def alternative_features(motion: RecordedMotion) -> dict[str, F]:
    """Return the features (k, n) of what looks like a delay: inertia, forces that depend on position, a slow valve.

    Inertia is missing if only a negative mass, or one beyond DelayLimits.MAX_MASS_KG, fits.
    """
    speeds, x = hats(motion.speed, COARSE_KNOTS), normalize(motion.position)
    at = hats(motion.position, COARSE_KNOTS)
    maps = [x, x**2, *at[1:-1]]
    if not is_constant(motion.current):
        maps += [x * (n := normalize(motion.current)), x**2 * n]
    features = {SPRING: np.concatenate([at, *(speeds * feature for feature in maps)])}
    if 0.0 < moved_mass(motion) <= DelayLimits.MAX_MASS_KG:
        low_passes = (butter(2, hertz, fs=RATE_HZ, output="sos") for hertz in ACCELERATION_HZ)  # against its noise
        features[INERTIA] = np.stack([normalize(sosfiltfilt(low, np.gradient(motion.speed))) for low in low_passes])
    if not is_constant(motion.current):
        slow = [lag(normalize(motion.current), seconds) for seconds in SLOW_VALVE_LAGS_S]
        features[SLOW_VALVE] = np.concatenate([speeds * feature for feature in slow])
    return features


def moved_mass(motion: RecordedMotion) -> float:
    """Return the mass [kg] whose inertia, beside a map of speed and current, fits the force best; any sign."""
    acceleration = np.gradient(motion.speed) * RATE_HZ
    speeds, n = hats(motion.speed, KNOTS), normalize(motion.current)
    damping = np.concatenate([speeds, speeds * n, normalize(motion.position)[None]])
    weights = np.linalg.lstsq(damping.T, np.stack([acceleration, motion.force], axis=1), rcond=1e-8)[0]
    inertial, force = np.stack([acceleration, motion.force]) - weights.T @ damping
    return float(inertial @ force) / max(float(inertial @ inertial), 1e-30)


def is_constant(current: F) -> bool:
    """Return whether a current hardly changes."""
    return bool(current.std() <= DelayLimits.SAME_CURRENT * max(abs(float(current.mean())), 1e-3))


def hats(values: F, quantiles: tuple[float, ...]) -> F:
    """Return piecewise linear functions (k, n) with knots at the quantiles; they sum to one."""
    knots = np.unique(np.quantile(values, quantiles))
    return np.stack([np.interp(values, knots, row) for row in np.eye(len(knots))])


def lag(values: F, seconds: float) -> F:
    """Return signals (..., n) behind a first-order lag."""
    if seconds == 0.0:
        return values
    keep = float(np.exp(-1.0 / (RATE_HZ * seconds)))
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], values, axis=-1))


def normalize(values: F) -> F:
    """Return a signal (n,) with mean 0 and standard deviation 1."""
    return np.asarray((values - values.mean()) / max(float(values.std()), 1e-30))


def fit_errors(features: F, targets: F) -> F:
    """Return the relative error (m,) of the least-squares fit of each column of `targets` (n, m)."""
    a, y = features - features.mean(axis=0), targets - targets.mean(axis=0)
    gram = a.T @ a
    damped = gram + RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
    right = a.T @ y
    weights = np.linalg.solve(damped, right)
    energy = np.maximum((y**2).sum(axis=0), 1e-30)
    left = energy - 2.0 * (weights * right).sum(axis=0) + (weights * (gram @ weights)).sum(axis=0)
    return np.asarray(np.sqrt(np.maximum(left, 0.0) / energy))
