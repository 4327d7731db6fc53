"""The design of a bank: what a stroke is like in; the numbers of the modes out (see `ces_observer.tick.bank`).

A sample need not lie at its tick: rows and gains of the measurement are moved to the nearest of SHIFTS, so that a mode
is nearly as stable as with samples on the ticks. After lost ticks, the gains are those of the next longer span: those
of a shorter one are too large.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from math import cos, exp, pi, sqrt
from typing import NamedTuple

from ces_observer.tick.bank import BINS, EARLIEST

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


SPEED, ACCELERATION = "speed", "acceleration"
AFTER_S = 1e-3  # [s] in which the worth of a late correction fades
FREEDOM = 9.0  # degrees of freedom of Student's t; the likelihood is then a power of -5
DRIFT = 1.0  # [m/s2 per root second] of an accelerometer's offset
SHIFTS = range(-EARLIEST, BINS // 2 + 1)  # [bins] from its tick
MIN_NOISE = 0.02  # of the position, times the RMS speed per tick: gains of less do not bear half a bin
MIN_MOTION_NOISE = 1e-4  # of the speed or acceleration, times that of the stroke: rounding needs no less


@dataclass(frozen=True)
class BankSettings:
    """What a bank knows: RMS speed [m/s] of the stroke, RMS noise [m] of the position, frequencies [Hz] of the modes.

    `motion` is the signal measured beside the position (SPEED, ACCELERATION or empty), with its RMS noise in SI units.
    """

    rate_Hz: float
    noise_m: float
    speed_m_s: float
    frequencies_Hz: tuple[float, ...]
    max_gap_s: float
    motion: str = ""
    motion_noise: float = 0.0


@dataclass(frozen=True)
class Gains:
    """Gains on the innovations of position and motion (one or two numbers) for a span of ticks and a shift.

    `position` and `speed` are those of the outputs, `states` those of the next predicted x, v, z1, z2, z3 (and the
    offset). Innovations e have the likelihood `height` / (1 + e' `sharpness` e)^5, given by the terms 11, 12 + 21, 22.
    """

    position: tuple[float, ...]
    speed: tuple[float, ...]
    states: tuple[tuple[float, ...], ...]
    sharpness: tuple[float, ...]
    height: float


@dataclass(frozen=True)
class BankMode:
    """The numbers of a mode: a1 to a4 (`speed`) and b0 to b3 (`position`) of its companion form.

    `measured` and `motion` are the weights of v, z1, z2 and z3 in the position and in the second measurement, for each
    of SHIFTS. `gains` are those for each span from the last measurement and each of SHIFTS; `smoothing` those of the
    speed on the innovations 0 to `delay` ticks later.
    """

    speed: tuple[float, ...]
    position: tuple[float, ...]
    measured: tuple[tuple[float, ...], ...]
    motion: tuple[tuple[float, ...], ...]
    gains: tuple[tuple[Gains, ...], ...]
    smoothing: tuple[tuple[float, ...], ...]


def spans_of(stroke: BankSettings) -> tuple[int, ...]:
    """Return the spans [ticks] for which there are gains, up to the longest gap: 1, 2, 3, 4, 6, 8, 12, ..."""
    spans = [1, 2, 3]
    while spans[-1] < stroke.max_gap_s * stroke.rate_Hz + 1.0:
        spans.append(2 * spans[-2])
    return tuple(spans)


@lru_cache(maxsize=32)
def design_bank(stroke: BankSettings, delay: int = 0) -> tuple[BankMode, ...]:
    """Return the modes, with gains for all gaps that are bridged."""
    return tuple(_design_mode(stroke, frequency, delay) for frequency in stroke.frequencies_Hz)


def response_s(stroke: BankSettings) -> float:
    """Return the time [s] in which the fastest mode responds to a wrong speed, if the position alone is measured."""
    fastest = replace(stroke, frequencies_Hz=(max(stroke.frequencies_Hz),), max_gap_s=0.0, motion="", motion_noise=0.0)
    gains = design_bank(fastest)[0].gains[0][EARLIEST]
    return gains.position[0] / gains.speed[0]


def _design_mode(stroke: BankSettings, frequency_Hz: float, delay: int) -> BankMode:
    omega, tick = 2.0 * pi * frequency_Hz, 1.0 / stroke.rate_Hz
    alone = free_motion(omega * tick, (stroke.speed_m_s / omega) ** 2)
    factors = tuple(speed_predictor(omega * tick))
    basis = _companion_basis(alone.advance, omega, factors)
    motion, rows, noise, units = _measurements(stroke, alone, omega)
    moves = _moves(free_motion(omega * tick / BINS, 1.0).advance, len(rows[0]))
    states = basis if len(rows[0]) == ORDER else _with_last(basis, omega * omega)
    nexts = {shift: product(states, moves[BINS - shift]) for shift in SHIFTS}
    gains: list[tuple[Gains, ...]] = []
    advances = [motion, join(motion, motion)]
    advances.append(join(advances[1], motion))
    for span in spans_of(stroke):
        if len(gains) == len(advances):
            advances.append(join(advances[-2], advances[-2]))
        filtered = stationary(advances[len(gains)], rows, noise)
        now = smoothing_gains(advances[len(gains)], rows, filtered, 0, exp(-span * tick / AFTER_S))[0]
        likelihood = _likelihood(stroke, filtered.spread, units)
        if span == 1:
            smoothing = smoothing_gains(motion, rows, filtered, delay, exp(-tick / AFTER_S))
        gains.append(
            tuple(
                Gains(
                    _scale(product(moves[-shift][:1], filtered.gain)[0], units),
                    _scale(product(moves[-shift][1:2], now)[0], units, omega),
                    tuple(_scale(row, units) for row in product(nexts[shift], filtered.gain)),
                    *likelihood,
                )
                for shift in SHIFTS
            )
        )
    order = 2 if stroke.motion == ACCELERATION else 1
    return BankMode(
        factors,
        _in_companion(basis, alone.advance[0]),
        tuple(_in_companion(basis, moves[shift][0][:ORDER]) for shift in SHIFTS),
        tuple(_in_companion(basis, [omega**order * x for x in moves[shift][order][:ORDER]]) for shift in SHIFTS),
        tuple(gains),
        tuple(_scale(gain[1], units, omega) for gain in smoothing),
    )


def _moves(step: Matrix, size: int) -> dict[int, Matrix]:
    """Return the free motion over all numbers of bins that are needed, from that over one."""
    step = _with_last(step, 1.0) if size > ORDER else step
    back, moves = solve(step, identity(size)), {0: identity(size)}
    for bins in range(BINS + EARLIEST):
        moves[bins + 1] = product(moves[bins], step)
        moves[-bins - 1] = product(moves[-bins], back)
    return moves


def _likelihood(stroke: BankSettings, spread: Matrix, units: Sequence[float]) -> tuple[tuple[float, ...], float]:
    """Return sharpness and height for innovations with a spread [m2]."""
    inverse = solve(spread, identity(len(spread)))
    sharpness = [x / units[i] / units[j] / FREEDOM for i, row in enumerate(inverse) for j, x in enumerate(row)]
    if len(spread) == 1:
        return (sharpness[0],), stroke.noise_m / sqrt(spread[0][0])
    size = spread[0][0] * spread[1][1] - spread[0][1] * spread[1][0]
    height = stroke.noise_m / (sqrt(size) * units[1])
    return (sharpness[0], sharpness[1] + sharpness[2], sharpness[3]), height


def _measurements(
    stroke: BankSettings, alone: FreeMotion, omega: float
) -> tuple[FreeMotion, Matrix, list[float], list[float]]:
    """Return motion, rows, variances [m2] and units (m per SI unit, inverted) of the measurements.

    States are in metres, so that a speed is measured over omega, and an acceleration, with its offset, over omega2.
    """
    noise_m = max(stroke.noise_m, MIN_NOISE * stroke.speed_m_s / stroke.rate_Hz)
    rows, noise, units = [[1.0, 0.0, 0.0, 0.0, 0.0]], [noise_m**2], [1.0]
    if stroke.motion == SPEED:
        rows.append([0.0, 1.0, 0.0, 0.0, 0.0])
        units.append(omega)
    elif stroke.motion == ACCELERATION:
        rows = [[*rows[0], 0.0], [0.0, 0.0, 1.0, 0.0, 0.0, 1.0]]
        units.append(omega * omega)
        drift = (DRIFT / units[1]) ** 2 / stroke.rate_Hz
        alone = FreeMotion(_with_last(alone.advance, 1.0), _with_last(alone.noise, drift))
    if stroke.motion:
        noise.append(max(stroke.motion_noise / units[1], MIN_MOTION_NOISE * stroke.speed_m_s / omega) ** 2)
    return alone, rows, noise, units


def _with_last(a: Matrix, corner: float) -> Matrix:
    return [*([*row, 0.0] for row in a), [0.0] * len(a) + [corner]]


def _scale(row: Sequence[float], units: Sequence[float], factor: float = 1.0) -> tuple[float, ...]:
    return tuple(factor * x / unit for x, unit in zip(row, units, strict=True))


def _companion_basis(advance: Matrix, omega: float, factors: Sequence[float]) -> Matrix:
    """Return x, v, z1, z2 and z3 as rows in the coordinates of `kalman`."""
    speed = [0.0, omega, 0.0, 0.0, 0.0]
    rows = [[1.0, 0.0, 0.0, 0.0, 0.0], speed]
    for factor in factors[:3]:
        moved = product([rows[-1]], advance)[0]
        rows.append([x - factor * y for x, y in zip(moved, speed, strict=True)])
    return rows


def _in_companion(basis: Matrix, row: Sequence[float]) -> tuple[float, ...]:
    """Return the weights of v, z1, z2 and z3 that make up `row`."""
    return tuple(weight for (weight,) in solve(transpose(basis), [[x] for x in row])[1:])
