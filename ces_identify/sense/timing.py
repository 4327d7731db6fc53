"""Signals that do not fit together in time or sign: delays between channels, a reversed sign."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ces_identify.recordings.checks import WARNING, WRONG_MODEL, Finding
from ces_identify.sense.delays import DelayEstimate, current_delay, force_delay
from ces_identify.sense.motion import RATE_HZ, Motion

MIN_DELAY_S, WRONG_DELAY_S = 0.002, 0.005  # that the interval must exclude to be reported; to be refused
IS_DELAY = "the key delay"  # in the text of each finding on one
BLOCK_TICKS = 500
MIN_WORK, MIN_BLOCKS = 0.3, 0.8  # share of the power that is negative on balance, and of the blocks


def timing_findings(motion: Motion) -> Iterator[Finding]:
    """Yield findings on delays, and on the sign of the force."""
    delay = force_delay(motion)
    yield from delay_findings(motion, delay)
    yield from sign_findings(motion, delay)


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


def sign_findings(motion: Motion, delay: DelayEstimate | None = None) -> Iterator[Finding]:
    """Yield a finding if the force, moved back by its delay, drives the piston."""
    if is_reversed(motion, delay):
        yield Finding(
            WRONG_MODEL,
            "force: acts with the motion instead of against it, and no damper gives energy; position and force are "
            "positive in compression: multiply the scale of the one that is not by -1 in the signals file",
        )


def delay_findings(motion: Motion, force: DelayEstimate | None) -> Iterator[Finding]:
    """Yield the delay of force or position, and that of the current if it fits neither of the two."""
    if force is not None and abs(force.nearest_s) >= MIN_DELAY_S:
        yield _describe_delay("force", "position", force)
    elif force is not None and force.likely:
        yield _describe_likely("force", "position", force)
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
        f"{abs(delay.late_s):.3f} to {IS_DELAY} (default 0) of {late} in the signals file",
    )


def _describe_likely(signal: str, other: str, delay: DelayEstimate) -> Finding:
    """Return a warning: the delay fits best, but the elasticity of the damper may be what is seen."""
    late, reference = (signal, other) if delay.late_s > 0.0 else (other, signal)
    low, high = sorted(np.sign(delay.late_s) * 1e3 * s for s in (delay.low_s, delay.high_s))
    return Finding(
        WARNING,
        f"{late}: perhaps logged {1e3 * abs(delay.late_s):.0f} ms after the {reference}; {low:.0f} to {high:.0f} ms "
        "fit, too, as a damper's elasticity does on these strokes: check with faster and more varied ones, or "
        f"set {IS_DELAY} (default 0) of {late} in the signals file",
    )
