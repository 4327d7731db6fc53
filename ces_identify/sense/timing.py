"""Signals that do not fit together in time or sign: delays between channels, a reversed sign, too low a rate."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.signal import welch

from ces_identify.recordings.checks import WARNING, WRONG_MODEL, Finding, mean_rate
from ces_identify.recordings.recording import Recording
from ces_identify.sense.delays import DelayEstimate, current_delay, force_delay
from ces_identify.sense.motion import RATE_HZ, Motion

MIN_DELAY_S, WRONG_DELAY_S = 0.002, 0.005  # that the interval must exclude to be reported; to be refused
BLOCK_TICKS = 500
MIN_WORK, MIN_BLOCKS = 0.3, 0.8  # share of the power that is negative on balance, and of the blocks
LOW_RATE_HZ = 400.0  # above it, what is near half the rate is the noise of the load cell
NEAR_LIMIT = 0.3  # RMS share of the force in the upper half of the band


def timing_findings(recording: Recording, motion: Motion | None) -> Iterator[Finding]:
    """Yield findings on delays, on the sign of the force, and on the rate of the recording."""
    if motion is not None:
        delay = force_delay(motion)
        yield from _delays(motion, delay)
        yield from _sign(motion, delay)
    yield from _low_rate(recording)


def dissipation(motion: Motion, late_s: float = 0.0) -> tuple[float, float]:
    """Return the dissipated over the exchanged power (-1 to 1), and the share of blocks that return energy.

    A damper dissipates on balance, whatever its spring, friction or lag. `late_s` is the delay of the force.
    """
    shift = round(late_s * RATE_HZ)
    force = motion.force - motion.force.mean()
    power = np.roll(force, -shift) * motion.speed
    power = power[max(0, -shift) : len(power) - max(0, shift)]
    blocks = np.array_split(power, max(1, len(power) // BLOCK_TICKS))
    size = np.array([np.abs(block).sum() for block in blocks])
    returned = np.array([block.sum() < 0.0 for block in blocks])
    total = float(size.sum())
    return (float(power.sum()) / total, float(size[returned].sum()) / total) if total > 0.0 else (0.0, 0.0)


def is_reversed(motion: Motion, delay: DelayEstimate | None) -> bool:
    """Return whether the recorded force drives the piston on balance: its sign or that of the position is wrong."""
    late = delay.late_s if delay is not None and delay.certain else 0.0
    balance, returned = dissipation(motion, late)
    return balance < -MIN_WORK and returned > MIN_BLOCKS


def _sign(motion: Motion, delay: DelayEstimate | None) -> Iterator[Finding]:
    if is_reversed(motion, delay):
        yield Finding(
            WRONG_MODEL,
            "force: acts with the motion instead of against it, and no damper gives energy; position and force are "
            "positive in compression: multiply the scale of the one that is not by -1 in the signals file",
        )


def _delays(motion: Motion, force: DelayEstimate | None) -> Iterator[Finding]:
    """Yield the delay of force or position, and that of the current if it fits neither of the two."""
    if force is not None and abs(force.nearest_s) >= MIN_DELAY_S:
        yield _describe_delay("force", "position", force)
    current = current_delay(motion, force.late_s if force is not None and force.certain else 0.0)
    if current is None or abs(current.nearest_s) < MIN_DELAY_S:
        return
    offset = force.late_s if force is not None and force.certain else 0.0
    if not current.low_s <= -offset <= current.high_s:  # it may be in line with the position instead
        yield _describe_delay("current", "force", current)


def _describe_delay(signal: str, other: str, delay: DelayEstimate) -> Finding:
    late, reference = (signal, other) if delay.late_s > 0.0 else (other, signal)
    size = sorted(1e3 * abs(s) for s in (delay.low_s, delay.high_s))
    severity = WRONG_MODEL if abs(delay.nearest_s) >= WRONG_DELAY_S else WARNING
    return Finding(
        severity,
        f"{late}: logged {1e3 * abs(delay.late_s):.0f} ms ({size[0]:.0f} to {size[1]:.0f}) after the {reference}; add "
        f"{abs(delay.late_s):.3f} to the key delay (default 0) of {late} in the signals file",
    )


def _low_rate(recording: Recording) -> Iterator[Finding]:
    channel = recording.channels.get("force")
    rate = mean_rate(channel) if channel is not None else 0.0
    if channel is None or not 0.0 < rate < LOW_RATE_HZ:
        return
    values = channel.values[np.isfinite(channel.values)]
    if len(values) < 64 or values.std() == 0.0:
        return
    frequency, power = welch(values - values.mean(), rate, nperseg=min(len(values), 1024))
    share = float(np.sqrt(power[frequency > 0.25 * rate].sum() / power[1:].sum()))
    if share > NEAR_LIMIT:
        yield Finding(
            WARNING,
            f"force: {share:.0%} of its RMS lies near half the rate of {rate:.0f} Hz, and more beyond; a model will "
            f"err by about half as much: record at {10.0 * rate:.0f} Hz or more",
        )
