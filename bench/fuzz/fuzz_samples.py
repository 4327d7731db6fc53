"""Faulty position samples and currents: quiet stretches with faults of every kind, from a seed."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf, nan, sin
from random import Random

from fuzz_targets import FuzzSample

MS = 1_000_000
EPISODE = 500  # samples
ODD = (
    *(nan, inf, -inf, 0.0, -0.0, 5e-324, -5e-324, 1e-300, 1.0, -1.0),
    *(1e3, 1e9, -1e9, 1e154, 1e308, -1.7e308, True, False),
)
STAMPS_NS = (
    *(0, 1, -1, MS, -MS, 10 * MS, 51 * MS, -51 * MS, 10**9, -(10**9)),
    *(3600 * 10**9, 2**31 * 10**9, -(2**62), 2**62),
)


def samples(random: Random, count: int) -> Iterator[FuzzSample]:
    """Yield `count` samples: good ones at a jittered rate, corrupted at random and in episodes."""
    stamp, spoilt, stuck = random.choice((0, 10**9, 1_700_000_000 * 10**9)), 0.0, None
    for k in range(count):
        if k % EPISODE == 0:  # an episode of its own kind
            spoilt = random.choice((0.0, 0.0, 0.002, 0.01, 0.2, 1.0))
            stuck = random.choice((None, None, None, None, random.uniform(-0.1, 0.1)))
            size, beat = random.choice((0.0, 0.02, 0.02, 0.05, 5.0)), random.choice((0.01, 0.1, 3.0))
            period_ns = random.choice((MS, MS, MS, MS, MS, MS // 3, 5 * MS, 40 * MS, 1))
        odd = random.random() < spoilt
        stamp += random.choice(STAMPS_NS) if odd and random.random() < 0.3 else _jitter(period_ns, random)
        position = stuck if stuck is not None else size * sin(beat * k)
        current = random.uniform(-0.2, 2.5) if k % 5 == 0 else None
        yield FuzzSample(
            stamp,
            _odd_number(random) if odd and random.random() < 0.5 else position,
            _odd_number(random) if odd and random.random() < 0.5 else current,
        )


def _jitter(period_ns: int, random: Random) -> int:
    return max(1, round(period_ns * random.gauss(1.0, 0.1)))


def _odd_number(random: Random) -> float:
    if random.random() < 0.5:
        return random.choice(ODD)
    return random.choice((-1.0, 1.0)) * 10.0 ** random.uniform(-320.0, 308.0)
