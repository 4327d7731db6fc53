"""Candidates of currents: random levels held for random times, filtered noise, sines, and single levels.

All are drawn independently of the stroke. A current that follows the stroke would leave combinations of speed and
current empty, and a model fitted to it cannot tell the one from the other.
"""

from __future__ import annotations

from collections.abc import Callable
from math import pi

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from ces_iterate.commands import INTERVAL_S
from ces_iterate.plan.limits import RigLimits

F = NDArray[np.float64]

LONGEST_HOLD_S = 1.0
SETTLE_S = 1.0  # of the filter before a noise


def draw_current(limits: RigLimits, count: int, rng: Generator) -> F:
    """Return a random current (count,) [A] within the limits."""
    kind = CURRENTS[int(rng.choice(len(CURRENTS), p=WEIGHTS))]
    share = np.clip(kind(limits, count, rng), 0.0, 1.0)
    return np.asarray(limits.low_A + (limits.high_A - limits.low_A) * share)


def _held_levels(limits: RigLimits, count: int, rng: Generator) -> F:
    """Return levels held for log-uniform times; stratified, so that any few of them cover the range."""
    longest = float(np.exp(rng.uniform(np.log(2.0 * limits.hold_s), np.log(max(LONGEST_HOLD_S, 3.0 * limits.hold_s)))))
    holds = np.exp(rng.uniform(np.log(limits.hold_s), np.log(longest), int(count * INTERVAL_S / limits.hold_s) + 2))
    strata = np.concatenate([rng.permutation(5) for _ in range(len(holds) // 5 + 1)])[: len(holds)]
    levels = (strata + rng.random(len(holds))) / 5.0
    levels = np.round(levels) if rng.random() < 0.25 else levels
    return np.asarray(levels[np.searchsorted(np.cumsum(holds), np.arange(count) * INTERVAL_S, side="right")])


def _noise(limits: RigLimits, count: int, rng: Generator) -> F:
    cutoff = float(np.exp(rng.uniform(np.log(0.7), np.log(8.0))))
    lead = round(SETTLE_S / INTERVAL_S)
    noise = sosfilt(butter(2, cutoff, fs=1.0 / INTERVAL_S, output="sos"), rng.standard_normal(lead + count))[lead:]
    return np.asarray(0.5 + 0.5 * np.tanh(rng.uniform(0.6, 1.5) * noise / noise.std() + rng.uniform(-0.3, 0.3)))


def _sine(limits: RigLimits, count: int, rng: Generator) -> F:
    frequency = float(np.exp(rng.uniform(np.log(0.3), np.log(8.0))))
    middle = float(rng.uniform(0.3, 0.7))
    angle = 2.0 * pi * (frequency * np.arange(count) * INTERVAL_S + rng.random())
    return np.asarray(middle + min(middle, 1.0 - middle) * np.sin(angle))


def _single_level(limits: RigLimits, count: int, rng: Generator) -> F:
    return np.full(count, float(rng.random()))


CURRENTS: tuple[Callable[[RigLimits, int, Generator], F], ...] = (_held_levels, _noise, _sine, _single_level)
WEIGHTS = (0.5, 0.25, 0.15, 0.1)
