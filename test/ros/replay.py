"""Samples to replay to a node, and what an estimator that is fed them in order makes of them."""

from __future__ import annotations

import random
from bisect import bisect_right
from math import nan

import pytest
from damper_models import plain_damper
from vehicle import Vehicle, stroke, wait

from ces_observer.estimator import Estimator
from ces_observer.model import Model

MS = 1_000_000
START_NS = 1_000_000_000_000_000_000
Samples = list[tuple[int, float]]  # (stamp [ns], value)


def jittered_positions(count: int) -> Samples:
    """Return positions [m] at 1 kHz with jitter, lost and repeated samples, an outlier and a NaN."""
    chance = random.Random(1)
    samples = [(START_NS + k * MS + chance.randrange(MS // 2), stroke(k * 1e-3)) for k in range(count)]
    samples[500] = (samples[500][0], nan)
    samples[600] = (samples[600][0], 0.09)
    samples[700] = samples[699]
    return samples[:800] + samples[820:]


def currents(count: int) -> Samples:
    """Return currents [A] each 10 ms, none equal to the one before, up to after the last of `count` positions."""
    return [(START_NS + 10 * k * MS, 0.5 + 0.2 * (k % 7)) for k in range(count // 10 + 2)]


def offline(positions: Samples, currents: Samples, model: Model | None = None) -> dict[int, tuple[float, float, float]]:
    """Return by stamp the position, speed and force of an estimator that is fed in order."""
    estimator = Estimator(model or plain_damper(max_gap_s=0.3))
    stamps = [stamp for stamp, _ in currents]
    found = {}
    for stamp, position in positions:
        force = estimator.step(stamp, position, currents[bisect_right(stamps, stamp) - 1][1])
        if force is not None:
            found[stamp] = (estimator.position, estimator.speed, force)
    return found


def require_equal(vehicle: Vehicle, expected: dict[int, tuple[float, float, float]]) -> None:
    """Wait for the estimates of `expected`, and for no others: stamps, positions, speeds and forces are the same."""
    wait(lambda: len(vehicle.estimates) >= len(expected), "all estimates")
    assert vehicle.stamps() == list(expected)
    for message, numbers in zip(vehicle.estimates, expected.values(), strict=True):
        found = (message.position[0], message.velocity[0], message.effort[0])
        assert found == pytest.approx(numbers, rel=1e-9)
    assert len(expected) > 1500
    assert max(abs(force) for _, _, force in expected.values()) > 100.0
