"""Steady-state Kalman filters of one kind of stroke: dimensionless model in; gains, variances and smoothing gains out.

The speed of the stroke is modelled as white noise behind two resonances (SHAPE) at one frequency f: without content far
above f, and predictable. Its state is (x, v/w, a/w^2, ...) [m] with w = 2 pi f, so a filter depends only on the angle
w T of a tick and on the variances. The stationary covariance solves the Riccati equation, by the doubling algorithm of
Chu, Fan & Lin (Linear Algebra Appl. 396, 2005). Runs once for a model, with the standard library alone.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from functools import reduce
from math import cos, exp, sqrt
from typing import NamedTuple

Matrix = list[list[float]]

SHAPE = (0.3, 0.8)  # damping of the two resonances
ORDER = 5
TERMS = 18  # of the exponential's power series at an angle of at most 1/4
DOUBLINGS = 60  # of the Riccati equation; far more than it needs
GAUSS = ((0.0469100770306680, 0.1184634425280945), (0.2307653449471585, 0.2393143352496832), (0.5, 0.2844444444444444),
         (0.7692346550528415, 0.2393143352496832), (0.9530899229693320, 0.1184634425280945))  # fmt: skip


class FreeMotion(NamedTuple):
    """Free motion over one or more ticks: `advance` F (5, 5) and `noise` Q (5, 5) [m2] that it adds."""

    advance: Matrix
    noise: Matrix


class Filter(NamedTuple):
    """A stationary filter of m measurements: `gain` K (n, m), `spread` S (m, m) of the innovations, `covariance` P."""

    gain: Matrix
    spread: Matrix
    covariance: Matrix


def product(a: Matrix, b: Matrix) -> Matrix:
    """Return a b. Sums are rounded at each term, which `sum` does not do in every version of Python."""
    columns = list(zip(*b, strict=True))
    return [[reduce(operator.add, map(operator.mul, row, column), 0.0) for column in columns] for row in a]


def transpose(a: Matrix) -> Matrix:
    """Return the transpose."""
    return [list(column) for column in zip(*a, strict=True)]


def add(a: Matrix, b: Matrix, scale: float = 1.0) -> Matrix:
    """Return a + scale b."""
    return [[x + scale * y for x, y in zip(p, q, strict=True)] for p, q in zip(a, b, strict=True)]


def identity(n: int) -> Matrix:
    """Return the identity."""
    return [[float(i == j) for j in range(n)] for i in range(n)]


def solve(a: Matrix, b: Matrix) -> Matrix:
    """Return the solution of a x = b, by elimination with row pivots."""
    n, rows = len(a), [[*p, *q] for p, q in zip(a, b, strict=True)]
    for i in range(n):
        best = max(range(i, n), key=lambda r: abs(rows[r][i]))
        rows[i], rows[best] = rows[best], rows[i]
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for r in range(n):
            if r != i and rows[r][i] != 0.0:
                factor = rows[r][i]
                rows[r] = [x - factor * y for x, y in zip(rows[r], rows[i], strict=True)]
    return [row[n:] for row in rows]


def _polynomial() -> list[float]:
    """Return the coefficients of 1, s, s2, s3 in the product of the resonances s2 + 2 z s + 1 (leading: 1)."""
    y, z = SHAPE
    return [1.0, 2.0 * (y + z), 2.0 + 4.0 * y * z, 2.0 * (y + z)]


def speed_variance() -> float:
    """Return the stationary variance of the speed for white noise of intensity 1 (integral of Routh's table)."""
    a0, a1, a2, a3 = _polynomial()
    return (a2 * a3 - a1) / (2.0 * a0 * (a1 * a2 * a3 - a1 * a1 - a0 * a3 * a3))


def free_motion(angle: float, variance: float) -> FreeMotion:
    """Return the motion over the time in which w t = `angle`; `variance` [m2] is that of v/w."""
    halvings = 0
    while angle > 0.25:
        angle, halvings = 0.5 * angle, halvings + 1
    a = [[float(j == i + 1) for j in range(ORDER)] for i in range(ORDER - 1)]
    a.append([0.0, *(-c for c in _polynomial())])
    intensity, noise = variance / speed_variance(), [[0.0] * ORDER for _ in range(ORDER)]
    for point, weight in GAUSS:
        response = [row[-1] for row in _exponential(a, point * angle)]
        noise = add(noise, [[x * y for y in response] for x in response], intensity * weight * angle)
    motion = FreeMotion(_exponential(a, angle), noise)
    for _ in range(halvings):
        motion = join(motion, motion)
    return motion


def join(first: FreeMotion, then: FreeMotion) -> FreeMotion:
    """Return the motion over the times of both."""
    f, q = then
    return FreeMotion(product(f, first.advance), add(q, product(product(f, first.noise), transpose(f))))


def _exponential(a: Matrix, t: float) -> Matrix:
    total = term = identity(len(a))
    for k in range(1, TERMS):
        term = [[t / k * x for x in row] for row in product(term, a)]
        total = add(total, term)
    return total


def speed_predictor(angle: float) -> list[float]:
    """Return a of v(k+4) = a0 v(k+3) + ... + a3 v(k), the motion of the speed alone over four ticks."""
    y, z = (_pair(damping, angle) for damping in SHAPE)
    return [y[0] + z[0], y[1] + z[1] - y[0] * z[0], -y[0] * z[1] - y[1] * z[0], -y[1] * z[1]]


def _pair(damping: float, angle: float) -> tuple[float, float]:
    """Return p, q of v(k+2) = p v(k+1) + q v(k) for one resonance."""
    radius = exp(-damping * angle)
    return 2.0 * radius * cos(angle * sqrt(1.0 - damping * damping)), -radius * radius


def stationary(motion: FreeMotion, rows: Matrix, noise: Sequence[float]) -> Filter:
    """Return the stationary filter for measurements `rows` (m, n) of the state with variances `noise` (m,)."""
    scaled = [[x / variance for x in row] for row, variance in zip(rows, noise, strict=True)]
    unit, a = identity(len(motion.advance)), transpose(motion.advance)
    g, h = product(transpose(rows), scaled), motion.noise
    for _ in range(DOUBLINGS):
        both = solve(add(unit, product(g, h)), [p + q for p, q in zip(a, g, strict=True)])
        left, right = ([row[part] for row in both] for part in (slice(len(a)), slice(len(a), None)))
        step = product(product(transpose(a), h), left)
        g, h = add(g, product(product(a, right), transpose(a))), add(h, step)
        a = product(a, left)
        if max(abs(step[i][i]) for i in range(len(h))) <= 1e-15 * max(h[i][i] for i in range(len(h))):
            break
    h = [[0.5 * (h[i][j] + h[j][i]) for j in range(len(h))] for i in range(len(h))]
    seen = product(rows, h)
    spread = add(
        product(seen, transpose(rows)), [[v * (i == j) for j in range(len(noise))] for i, v in enumerate(noise)]
    )
    return Filter(transpose(solve(spread, seen)), spread, h)


def smoothing_gains(motion: FreeMotion, rows: Matrix, filtered: Filter, delay: int, fade: float) -> list[Matrix]:
    """Return the gains (n, m) on the innovations 0 to `delay` ticks later.

    The last one also holds those of still later innovations times powers of `fade`, which correct afterwards.
    """
    closed = transpose(add(motion.advance, product(product(motion.advance, filtered.gain), rows), -1.0))
    inverse = solve(filtered.spread, identity(len(rows)))
    seen = product(transpose(rows), inverse)
    gains = []
    for j in range(delay + 1):
        gain = seen if j < delay else solve(add(identity(len(closed)), closed, -fade), seen)
        gains.append(product(filtered.covariance, gain))
        seen = product(closed, seen)
    return gains
