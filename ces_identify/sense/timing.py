"""Signals that do not fit together in time or sign: delays between channels, a reversed sign."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ces_identify.recordings.checks import WARNING, WRONG_MODEL, Finding
from ces_identify.sense.delays import MAX_DELAY_S, DelayEstimate, current_delay, force_delay
from ces_identify.sense.motion import RATE_HZ, Motion

MIN_DELAY_S, WRONG_DELAY_S = 0.002, 0.005  # that the interval must exclude to be reported; to be refused
IS_DELAY = "the key delay"  # in the text of each finding on one
BLOCK_TICKS = 500
MIN_WORK, MIN_BLOCKS = 0.3, 0.8  # share of the power that is negative on balance, and of the blocks


def timing_findings(motion: Motion) -> Iterator[Finding]:
    """Yield findings on the sign of the force or, where it is right, on delays."""
    delay = force_delay(motion)
    yield from list(sign_findings(motion, delay)) or delay_findings(motion, delay)


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
    """Return whether the recorded force drives the piston on balance: its sign or that of the position is wrong.

    A force that is late by half a stroke does so, too: of an unknown delay, nothing follows.
    """
    if delay is not None and delay.certain and delay.beyond:
        return False
    late = delay.late_s if delay is not None and delay.certain else 0.0
    balance, returned = dissipation(motion, late)
    return balance < -MIN_WORK and returned > MIN_BLOCKS


def sign_findings(motion: Motion, delay: DelayEstimate | None = None) -> Iterator[Finding]:
    """Yield a finding if the force, moved back by its delay, drives the piston."""
    if is_reversed(motion, delay):
        yield Finding(
            WRONG_MODEL,
            "force: acts with the motion instead of against it, and no damper gives energy; position and force are "
            "positive in compression: multiply the scale of the one that is not by -1 in the signals file (if both "
            "are, one is late by half a stroke: align their clocks)",
            signal="force",
        )


def delay_findings(motion: Motion, force: DelayEstimate | None) -> Iterator[Finding]:
    """Yield the delay of force or position, and that of the current if it fits neither of the two."""
    moved = _current_instead(motion, force) if force is not None and (force.certain or force.likely) else None
    if moved is not None:
        yield (_describe_delay if abs(moved.nearest_s) >= MIN_DELAY_S else _describe_likely)("current", "force", moved)
        return
    if force is not None and abs(force.nearest_s) >= MIN_DELAY_S:
        yield _describe_delay("force", "position", force)
    elif force is not None and force.likely:
        yield _describe_likely("force", "position", force)
    offset = force.late_s if force is not None and force.certain else 0.0
    if abs(offset) > 0.5 * MAX_DELAY_S:  # the shifts that are tried do not reach the position's time
        return
    current = current_delay(motion, offset)
    if current is None or abs(current.nearest_s) < MIN_DELAY_S:
        return
    if not current.low_s <= -offset <= current.high_s:  # it may be in line with the position instead
        yield _describe_delay("current", "force", current)


def _current_instead(motion: Motion, force: DelayEstimate) -> DelayEstimate | None:
    """Return the delay of the current if it explains the force at least as well as `force`, that of the force, does."""
    current = current_delay(motion)
    if current is None or abs(current.late_s) < MIN_DELAY_S:
        return None
    again = force_delay(replace(motion, current=np.roll(motion.current, -round(current.late_s * RATE_HZ))))
    in_line = again is not None and abs(again.nearest_s) < MIN_DELAY_S and not again.likely
    return current if again is not None and in_line and again.error_at_zero <= force.least_error else None


def _describe_delay(signal: str, other: str, delay: DelayEstimate) -> Finding:
    severity = WRONG_MODEL if abs(delay.nearest_s) >= WRONG_DELAY_S else WARNING
    near, far = sorted(1e3 * abs(s) for s in (delay.low_s, delay.high_s))
    name, relation, key_s = _name_late(signal, other, delay.late_s)
    if delay.beyond:
        text = (
            f"{name}: logged at least {near:.0f} ms {relation}, too much to estimate; compare how both are stamped, set"
        )
        return Finding(
            severity, f"{text} {IS_DELAY} (default 0) of {name} in the signals file, and check again", signal=name
        )
    interval = f"{near:.0f} ms or more" if delay.open_ended else f"{near:.0f} to {far:.0f}"
    return Finding(
        severity,
        f"{name}: logged {1e3 * abs(delay.late_s):.0f} ms ({interval}) {relation}; add {key_s:.3f} "
        f"to {IS_DELAY} (default 0) of {name} in the signals file",
        signal=name,
    )


def _describe_likely(signal: str, other: str, delay: DelayEstimate) -> Finding:
    """Return a warning: the delay fits best, but the elasticity of the damper, or its valve, may be what is seen."""
    low, high = sorted(np.sign(delay.late_s) * 1e3 * s for s in (delay.low_s, delay.high_s))
    name, relation, _ = _name_late(signal, other, delay.late_s)
    cause = "valve" if signal == "current" else "elasticity"
    return Finding(
        WARNING,
        f"{name}: perhaps logged {1e3 * abs(delay.late_s):.0f} ms {relation}; {low:.0f} to {high:.0f} ms fit, too, as "
        f"a damper's {cause} does on these strokes: check with faster and more varied ones, or set {IS_DELAY} "
        f"(default 0) of {name} in the signals file",
        signal=name,
    )


def _name_late(signal: str, other: str, late_s: float) -> tuple[str, str, float]:
    """Return the signal to correct, its relation to the other, and what to add to its key [s].

    Of force and position it is the late one. The current is corrected itself, also if it is early: the force is in line
    with the position.
    """
    if signal == "current" and late_s < 0.0:
        return signal, f"before the {other}", late_s
    late, reference = (signal, other) if late_s > 0.0 else (other, signal)
    return late, f"after the {reference}", abs(late_s)
