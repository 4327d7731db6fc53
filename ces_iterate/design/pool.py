"""The motions that a model is meant for, as far as the limits say: a pool of random motions, drawn once for a plan.

Its states are the targets of the design. Every motion counts the same, slow ones as much as fast ones, as the cost J
relates every error to the force of its own recording.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ces_identify.numerics.arrays import F, I
from ces_iterate.commands import INTERVAL_S, RigCommands
from ces_iterate.design.currents import draw_current
from ces_iterate.design.features import scaled_state
from ces_iterate.design.motions import draw_motion
from ces_iterate.plan.limits import RigLimits

MOTIONS = 96
LENGTH_S = 2.0  # of a motion
LEAD_S = 0.5  # of a motion that does not count, while models settle
PER_MOTION = 24  # states


@dataclass(frozen=True)
class Pool:
    """`motions`, the `ticks` (m,) of each that are targets, and the targets' `state` (motions * m, 5)."""

    motions: tuple[RigCommands, ...]
    ticks: I
    state: F
    speed_m_s: F
    current_A: F
    stroke_m: F


def draw_pool(limits: RigLimits, seed: int) -> Pool:
    """Return the pool that belongs to a seed."""
    rng = np.random.default_rng([seed, 13])
    count = round(LENGTH_S / INTERVAL_S) + 1
    ticks = np.linspace(LEAD_S / INTERVAL_S, count - 1, PER_MOTION).astype(np.int64)
    motions = tuple(
        RigCommands(f"pool {k}", limits.centre_m + draw_motion(limits, count, rng), draw_current(limits, count, rng))
        for k in range(MOTIONS)
    )
    speeds = [motion.motion()[0] for motion in motions]
    states = [scaled_state(m.stroke_m, v, m.current_A, limits)[ticks] for m, v in zip(motions, speeds, strict=True)]
    at = [np.concatenate([signal[ticks] for signal in signals]) for signals in (
        speeds, [m.current_A for m in motions], [m.stroke_m for m in motions])]  # fmt: skip
    return Pool(motions, ticks, np.concatenate(states), *at)
