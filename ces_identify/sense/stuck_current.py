"""A current that stands still in the recording while the valve's moves: a frozen, stuck or lost signal.

A commanded current may rightly be constant for seconds. But at one current, a damper has one force at one motion: where
the force of a stretch of one recorded current follows the motion much worse than the rest of the recording follows
motion and current, the true current has changed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ces_identify.numerics.arrays import F, I
from ces_identify.recordings.checks import WARNING, WRONG_MODEL, Finding, mean_rate
from ces_identify.recordings.recording import Channel, Recording
from ces_identify.sense.force_map import fit_errors, force_features, is_constant
from ces_identify.sense.motion import RATE_HZ, Motion
from ces_identify.sense.sensors import MIN_SAMPLES, NOISY_REPEATS, STUCK_SAMPLES, count_times, runs_of_equal

MAX_STRETCHES, MIN_STRETCH_S, SETTLING_S = (
    3,
    1.0,
    0.2,
)  # of one current; at its begin, the valve still answers to the one before
MIN_REST, MIN_MOTION = 0.2, 0.3  # share of the time outside, to compare with; of the speed inside
RATIO, MIN_ERROR = 2.0, 0.15  # of the errors inside and outside; the least that counts
WRONG_SHARE = 0.02  # of the time
STUCK_S = 0.5  # in a noisy current
REMEDY = "check the sensor and its cable, and cut these stretches out"


def current_findings(recording: Recording, motion: Motion | None) -> Iterator[Finding]:
    """Yield a finding if the recorded current stands still while the force, or its own noise, shows a fault."""
    channel = recording.channels.get("current")
    if channel is not None:
        by_force = _unlike_force(motion) if motion is not None and not is_constant(motion.current) else None
        yield from [by_force] if by_force else _without_noise(channel.select(np.isfinite(channel.values)))


def _unlike_force(motion: Motion) -> Finding | None:
    """Return a finding on the first stretch of one current in which the force changes as if the current moved."""
    for begin, end in _longest_stretches(motion.current):
        rest = np.concatenate([np.arange(begin), np.arange(end, len(motion))])
        if len(rest) < MIN_REST * len(motion):
            continue
        inside, outside = _error(motion, np.arange(begin + round(SETTLING_S * RATE_HZ), end)), _error(motion, rest)
        if inside > max(RATIO * outside, MIN_ERROR):
            share = (end - begin) / len(motion)
            return Finding(
                WRONG_MODEL if share > WRONG_SHARE else WARNING,
                f"current: stuck at {motion.current[begin]:.3g} A for {(end - begin) / RATE_HZ:.1f} s, {share:.0%} of "
                f"the time, while the force changes as if it moved ({inside:.0%} of it does not follow the motion, "
                f"{outside:.0%} elsewhere); {REMEDY}",
                signal="current",
            )
    return None


def _without_noise(channel: Channel) -> Iterator[Finding]:
    """Yield the stretches in which a current whose noise changes it everywhere else repeats one value."""
    if len(channel) < MIN_SAMPLES or np.ptp(channel.values) == 0.0:
        return
    runs = runs_of_equal(channel.values)
    lengths = runs[:, 1] - runs[:, 0]
    long = lengths >= max(STUCK_SAMPLES, STUCK_S * mean_rate(channel))
    rest = lengths[~long]
    if long.any() and len(rest) and (rest - 1).sum() <= NOISY_REPEATS * rest.sum():
        begin, total = int(runs[long][0, 0]), lengths[long].sum() / len(channel)
        first = (channel.stamps_ns[begin] - channel.stamps_ns[0]) * 1e-9
        yield Finding(
            WARNING,
            f"current: stuck {count_times(int(long.sum()))} {first:.2f} s, {total:.1%} of the time, although noise "
            f"changes it everywhere else; {REMEDY}",
            signal="current",
        )


def _longest_stretches(current: F) -> I:
    """Return begin and end (n, 2) of the longest stretches of exactly one current."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(current)) + 1, [len(current)]])
    spans = np.stack([edges[:-1], edges[1:]], axis=1)
    lengths = spans[:, 1] - spans[:, 0]
    longest = np.argsort(-lengths, kind="stable")[:MAX_STRETCHES]
    return np.asarray(spans[longest][lengths[longest] >= MIN_STRETCH_S * RATE_HZ])


def _error(motion: Motion, ticks: I) -> float:
    """Return the relative error of the map from motion and current to the force on these ticks; 0 if little moves."""
    signals = {name: getattr(motion, name)[ticks] for name in ("position", "speed", "force", "current")}
    part = replace(motion, **signals, parts=())
    if part.speed.std() < MIN_MOTION * motion.speed.std() or part.force.std() == 0.0:
        return 0.0
    return float(fit_errors(force_features(part).T, part.force[:, None])[0])
