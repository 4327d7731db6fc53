"""Gaps and blocks for the tests of the shrink."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from engine_plant import traced
from numpy.typing import NDArray

from ces_gap.inference.held_out import Blocks, cut_into_blocks
from ces_gap.trace import Trace

F = NDArray[np.float64]


NOISE_N = 8.0


@cache
def plain() -> tuple[Trace, ...]:
    return tuple(replace(traced(seed=s, seconds=10.0), noise_N=NOISE_N) for s in (1, 2, 3))


def gaps(rms_N: float, seed: int) -> list[F]:
    """A gap on each trace: slow, and of another strength every half second."""
    rng = np.random.default_rng(seed)
    forces = []
    for trace in plain():
        strength = rng.gamma(4.0, 0.25, 30)[(trace.time_s / 0.5).astype(int)]
        forces.append(rms_N * strength * np.sqrt(2.0 / 1.25) * np.sin(9.0 * trace.time_s + rng.random()))
    return forces


def make_blocks(gap: list[F], seed: int, noise_N: float = NOISE_N) -> Blocks:
    """The held-out traces with a gap and noise on their simulated force."""
    rng = np.random.default_rng(1000 + seed)
    traces = [
        replace(t, force=t.simulated + g + noise_N * rng.standard_normal(len(t)))
        for t, g in zip(plain(), gap, strict=True)
    ]
    return cut_into_blocks(traces, seed)
