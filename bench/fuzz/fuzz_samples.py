"""Faulty inputs from a seed: position samples and currents with faults of every kind, and corrupted files."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from copy import deepcopy
from math import inf, nan, sin
from random import Random
from typing import Any

from bench.fuzz.fuzz_targets import FuzzSample

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


NUMBERS = (
    *(0, 1, -1, 2, 3, 8, 999, 1000, 1001, 2**31, 2**63, 2**63 + 1, -(2**64), 10**400),
    *(-0.0, 0.5, -0.5, 1e-4, 1e6, -1e9, 1e9, 1e30, 1e300, -1.7e308, 5e-324, 1e-100, math.inf, -math.inf, math.nan),
)
TEXTS = (
    *("", "a", "force", "speed", "current", "position", "hysteresis", "by_stop_1", "nan", "1e9"),
    *("made0", "run", "__import__", "\n", "\0", "\ud800", "\u202e", "é", "x" * 20_000),
)
ATOMS: tuple[Any, ...] = (
    *NUMBERS,
    *TEXTS,
    *(True, False, None, [], {}, [0], [0, 1], [1, 0], [-1e6, 1e6], [0.0, 0.0], [5e-324, 1.0], {"a": 1}),
)
CLAUSES = (
    *(b"\xef\xbb\xbf", b"\xff", b"\0", b"\x80", b"NaN", b"Infinity", b"1e400"),
    *(b"[" * 5000, b"{}", b"//", b",,", b'"'),
)
MAX_CHANGES = 4


def spoil_model(raw: bytes, random: Random) -> bytes:
    """Return a model file's bytes, corrupted in its values, in its bytes or in both."""
    kind = random.random()
    if kind < 0.85:
        raw = _spoil_values(raw, random)
    return spoil_bytes(raw, random) if kind > 0.75 else raw


def spoil_bytes(raw: bytes, random: Random, clauses: tuple[bytes, ...] = CLAUSES) -> bytes:
    """Return bytes with some flipped, cut, doubled or moved, or with one of `clauses` inserted."""
    for _ in range(random.randint(1, MAX_CHANGES)):
        a, b = sorted(random.randrange(len(raw) + 1) for _ in range(2))
        raw = random.choice(
            (
                raw[:a] + random.choice(clauses) + raw[a:],
                raw[:a] + bytes([random.randrange(256)]) + raw[a + 1 :],
                raw[:a] + raw[a : min(b, a + 40)] + raw[a:],
                raw[:a] + raw[min(b, a + 20) :],
                raw[:b],
            )
        )
    return raw


def _spoil_values(raw: bytes, random: Random) -> bytes:
    try:
        tree = json.loads(raw)
    except (ValueError, RecursionError):
        return raw
    for _ in range(random.choice((1, 1, 1, 2, MAX_CHANGES))):
        tree = _change_value(tree, random)
    text = json.dumps(tree)
    if random.random() < 0.05:  # a key twice
        text = text.replace("{", '{"lag": 1, "lag": 2, ', random.randint(1, 3))
    return text.encode()


def _change_value(tree: Any, random: Random) -> Any:
    """Change one value somewhere in a tree."""
    if isinstance(tree, dict | list) and tree and random.random() < 0.9:
        at = random.choice(list(tree) if isinstance(tree, dict) else range(len(tree)))
        if random.random() < 0.05:
            return random.choice(CHANGES)(tree, at, random)
        tree[at] = _change_value(tree[at], random)
        return tree
    if isinstance(tree, float | int) and not isinstance(tree, bool) and random.random() < 0.8:
        return _other_number(tree, random)
    return deepcopy(random.choice(ATOMS))


def _other_number(number: float, random: Random) -> float:
    if isinstance(number, int):
        return number + random.choice((-1, 1, 2, 10, 1000))
    return number * random.choice((-1.0, 0.0, 0.1, 0.99, 1.01, 1.1, 2.0, 10.0, 1e3, 1e6, 1e-6)) + random.choice(
        (0.0, 0.0, 1e-3)
    )


def _remove(tree: Any, at: Any, random: Random) -> Any:
    del tree[at]
    return tree


def _repeat(tree: Any, at: Any, random: Random) -> Any:
    """Repeat the value: many times in a list, under another key in an object."""
    if isinstance(tree, list):
        return tree + [deepcopy(tree[at])] * random.choice((1, 2, 60, 600))
    return {**tree, random.choice(("power", "units", "terms", "x", at + "x")): tree[at]}


def _nest(tree: Any, at: Any, random: Random) -> Any:
    for _ in range(random.choice((1, 3, 40, 200))):
        tree = [tree] if random.random() < 0.5 else {"": tree}
    return tree


CHANGES: tuple[Callable[[Any, Any, Random], Any], ...] = (_remove, _remove, _repeat, _repeat, _nest)
