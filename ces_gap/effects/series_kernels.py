"""Compiled loops around the plant's map of speed and current: learning it, reading it, solving what depends on it."""

from __future__ import annotations

from math import copysign, exp, sqrt, tanh

import numpy as np
from numba import njit
from numpy.typing import NDArray

F = NDArray[np.float64]

THETA = 0.55  # of an implicit step: 0.5 is exact to second order but rings, 1 is damped but late
RATE_TOLERANCE = 1e-5  # [m/s] last step of Newton's method; what is left is of second order in it


@njit(cache=True, nogil=True, error_model="numpy")
def spline_normal(u: F, s: F, y: F, cells: int, levels: int) -> tuple[F, F]:
    """Return the normal matrix, its lower band (3·levels, m), and the right side (m,) of y over splines.

    Quadratic B-splines in `u` in [0, cells] by hats in `s` in [0, levels - 1] (n,); m = (cells + 2)·levels, the levels
    of a spline beside each other.
    """
    size = (cells + 2) * levels
    band, right = np.zeros((3 * levels, size)), np.zeros(size)
    place, value = np.empty(6, np.int64), np.empty(6)
    for k in range(len(u)):
        cell, t, low, w = _cell(u[k], s[k], cells, levels)
        basis = (0.5 * (1.0 - t) * (1.0 - t), 0.5 + t * (1.0 - t), 0.5 * t * t)
        for j in range(3):
            place[2 * j] = (cell + j) * levels + low
            place[2 * j + 1] = place[2 * j] + min(1, levels - 1)
            value[2 * j], value[2 * j + 1] = (1.0 - w) * basis[j], w * basis[j]
        for a in range(6):
            right[place[a]] += value[a] * y[k]
            for b in range(6):
                if place[a] >= place[b]:
                    band[place[a] - place[b], place[b]] += value[a] * value[b]
    return band, right


@njit(cache=True, nogil=True, error_model="numpy")
def _cell(u: float, s: float, cells: int, levels: int) -> tuple[int, float, int, float]:
    """Return the spline's cell, the place in it, the level below and the weight of the one above."""
    cell = min(max(int(u), 0), cells - 1)
    low = min(max(int(s), 0), max(levels - 2, 0))
    return cell, u - cell, low, s - low if levels > 1 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _spline(u: float, s: float, table: F) -> tuple[float, float]:
    """Return the spline and its derivative by u; `table` (cells + 2, levels) are its coefficients."""
    width, levels = table.shape
    cell, t, low, w = _cell(u, s, width - 2, levels)
    high = min(low + 1, levels - 1)
    a = (1.0 - w) * table[cell, low] + w * table[cell, high]
    b = (1.0 - w) * table[cell + 1, low] + w * table[cell + 1, high]
    c = (1.0 - w) * table[cell + 2, low] + w * table[cell + 2, high]
    value = 0.5 * a * (1.0 - t) * (1.0 - t) + b * (0.5 + t * (1.0 - t)) + 0.5 * c * t * t
    return value, -a * (1.0 - t) + b * (1.0 - 2.0 * t) + c * t


@njit(cache=True, nogil=True, error_model="numpy")
def warped(speed: float, narrow: float) -> float:
    """Return the speed [m/s] on an axis that is fine near 0: ±(√(1 + |v|/narrow) - 1)."""
    return copysign(sqrt(1.0 + abs(speed) / narrow) - 1.0, speed)


@njit(cache=True, nogil=True, error_model="numpy")
def steep(speed: float, s: float, narrow: float, reach: float, table: F) -> tuple[float, float]:
    """Return the force [N] and its derivative [N s/m], not negative, of a spline over the `warped` speed by level.

    The spline spans ±`reach` of the warped axis; beyond, the force is constant.
    """
    cells = table.shape[0] - 2
    at = warped(speed, narrow)
    u = (at / reach + 1.0) * (0.5 * cells)
    if u < 0.0 or u > cells:
        return _spline(min(max(u, 0.0), float(cells)), s, table)[0], 0.0
    value, slope = _spline(u, s, table)
    return value, max(slope, 0.0) * 0.25 * cells / (reach * narrow * (1.0 + abs(at)))


@njit(cache=True, nogil=True, error_model="numpy")
def steep_values(speed: F, s: F, narrow: float, reach: float, table: F) -> tuple[F, F]:
    """Return `steep` at every tick, each (n,)."""
    force, slope = np.empty_like(speed), np.empty_like(speed)
    for k in range(len(speed)):
        force[k], slope[k] = steep(speed[k], s[k], narrow, reach, table)
    return force, slope


@njit(cache=True, nogil=True, error_model="numpy")
def _law(force: float, top: float, stroke: F, compliance: F) -> tuple[float, float]:
    """Return stroke and compliance of a law tabled evenly over ±`top` [N], by cubic Hermite interpolation."""
    last = len(stroke) - 1
    span = 2.0 * top / last
    at = min(max((force + top) / span, 0.0), float(last))
    k = min(int(at), last - 1)
    t = at - k
    rise, a, b = stroke[k + 1] - stroke[k], compliance[k] * span, compliance[k + 1] * span
    bend, twist = 3.0 * rise - 2.0 * a - b, a + b - 2.0 * rise
    return stroke[k] + t * (a + t * (bend + t * twist)), max(a + t * (2.0 * bend + 3.0 * t * twist), 0.0) / span


@njit(cache=True, nogil=True, error_model="numpy")
def _strain_rate(
    v: float,
    s: float,
    m: float,
    z: float,
    guess: float,
    plant: tuple[float, float, F],
    law: tuple[float, F, F],
    inertia_s: tuple[float, float],
) -> float:
    """Return the rate g [m/s] at which s(f(v - g) + m) = z + (hθ + damping)·g, by Newton's method kept in a bracket.

    The equation falls with g, so it has one root.
    """
    low, high = -np.inf, np.inf
    g = guess
    whole = inertia_s[0] + inertia_s[1]
    for _ in range(40):
        value, slope = steep(v - g, s, plant[0], plant[1], plant[2])
        stroke, compliance = _law(value + m, law[0], law[1], law[2])
        wrong = stroke - z - whole * g
        if wrong > 0.0:
            low = g
        else:
            high = g
        move = wrong / (compliance * slope + whole)
        if not low < g + move < high and abs(low) < np.inf and abs(high) < np.inf:
            move = 0.5 * (low + high) - g
        g += move
        if abs(move) < RATE_TOLERANCE:
            break
    return g


@njit(cache=True, nogil=True, error_model="numpy")
def series_stroke(
    speed: F,
    level: F,
    memory: F,
    plant: tuple[float, float, F],
    law: tuple[float, F, F],
    damping_s: float,
    step_s: float,
    substeps: int,
) -> F:
    """Return the stroke z [m] (n,) of a spring in series: z + damping·dz/dt = s(f(v - dz/dt) + memory).

    `plant` is (narrow, reach, table) of `steep`, `law` (top, stroke, compliance) of s. Implicit steps of the θ-method.
    """
    out = np.empty_like(speed)
    h = step_s / substeps
    force = steep(speed[0], level[0], plant[0], plant[1], plant[2])[0] + memory[0]
    z, rate = _law(force, law[0], law[1], law[2])[0], 0.0
    out[0] = z
    for k in range(1, len(speed)):
        for j in range(1, substeps + 1):
            w = j / substeps
            v = speed[k - 1] + w * (speed[k] - speed[k - 1])
            s = level[k - 1] + w * (level[k] - level[k - 1])
            m = memory[k - 1] + w * (memory[k] - memory[k - 1])
            z += h * (1.0 - THETA) * rate
            rate = _strain_rate(v, s, m, z, rate, plant, law, (h * THETA, damping_s))
            z += h * THETA * rate
        out[k] = z
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def leaking_force(
    speed: F, level: F, rest: float, plant: tuple[float, float, F], own: float, law: tuple[float, F, F]
) -> F:
    """Return F = f(v - g) - rest [N] (n,), g = q(F) + own·(F - F₋₁) [m/s]: what leaks, and what squeezes the plant.

    `plant` is (narrow, reach, table) of `steep`, `own` the compliance of the plant's own spring over the step [m/(s N)]
    and F₋₁ the force a tick before. `law` (top, rate, its derivative by force) is of q(F) + own·F. Implicit Euler.
    """
    out = np.empty_like(speed)
    g = 0.0
    force = steep(speed[0], level[0], plant[0], plant[1], plant[2])[0] - rest
    for k in range(len(speed)):
        g = _strain_rate(speed[k], level[k], -rest, own * force, g, plant, law, (1.0, 0.0))
        force = steep(speed[k] - g, level[k], plant[0], plant[1], plant[2])[0] - rest
        out[k] = force
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def pumped_stroke(
    speed: F,
    level: F,
    memory: F,
    plant: tuple[float, float, F],
    own: tuple[float, float],
    added: tuple[float, float],
    widths: tuple[float, float],
    step_s: float,
    substeps: int,
) -> F:
    """Return the stroke z [m] (n,), dz/dt = C·dF/dt, of a compliance C added to that of the plant's own spring.

    Both have one compliance [m/N] while the damper is pushed and moves in, and another otherwise; `widths` [N], [m/s]
    are those of the change. F = f(v - (C + own)·df/dt - C·dm/dt) + memory m. Implicit Euler.
    """
    out = np.zeros_like(speed)
    h, g, z = step_s / substeps, 0.0, 0.0
    force = steep(speed[0], level[0], plant[0], plant[1], plant[2])[0]
    for i in range(1, (len(speed) - 1) * substeps + 1):
        k, w = (i - 1) // substeps, ((i - 1) % substeps + 1) / substeps
        v, s = speed[k] + w * (speed[k + 1] - speed[k]), level[k] + w * (level[k + 1] - level[k])
        rise = memory[k + 1] - memory[k]
        pumping = in_class(force + memory[k] + w * rise, v, widths)
        own_c = own[1] + pumping * (own[0] - own[1])
        added_c = added[1] + pumping * (added[0] - added[1])
        before = force - added_c * rise / substeps / max(own_c + added_c, 1e-15)
        g, now = _squeezed(v, s, before, g, (own_c + added_c) / h, plant)
        z += added_c * (now - force + rise / substeps)
        force = now
        out[k + 1] = z
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def in_class(force: float, speed: float, widths: tuple[float, float]) -> float:
    """Return from 0 to 1 how far a damper is pushed and moves in."""
    return 0.25 * (1.0 + tanh(force / widths[0])) * (1.0 + tanh(speed / widths[1]))


@njit(cache=True, nogil=True, error_model="numpy")
def _squeezed(
    v: float, s: float, before: float, guess: float, whole: float, plant: tuple[float, float, F]
) -> tuple[float, float]:
    """Return g [m/s] = whole·(f(v - g) - before), by Newton's method in a bracket, and that force f [N]."""
    low, high = -np.inf, np.inf
    g = guess
    for _ in range(40):
        value, slope = steep(v - g, s, plant[0], plant[1], plant[2])
        wrong = whole * (value - before) - g
        low, high = (g, high) if wrong > 0.0 else (low, g)
        move = wrong / (whole * slope + 1.0)
        if not low < g + move < high and abs(low) < np.inf and abs(high) < np.inf:
            move = 0.5 * (low + high) - g
        g += move
        if abs(move) < RATE_TOLERANCE:
            break
    return g, steep(v - g, s, plant[0], plant[1], plant[2])[0]


@njit(cache=True, nogil=True, error_model="numpy")
def forward_backward(x: F, pole: float) -> F:
    """Return x (n,) behind two first-order lags there and two back: a low-pass without delay, begun at its ends."""
    out = x.copy()
    for direction in (1, -1):
        first = 0 if direction > 0 else len(x) - 1
        a = b = out[first]
        for j in range(len(x)):
            k = first + direction * j
            a = out[k] + pole * (a - out[k])
            b = a + pole * (b - a)
            out[k] = b
    return out


def pole_of(corner_Hz: float, rate_Hz: float) -> float:
    """Return the pole for which `forward_backward` halves the power at `corner_Hz`."""
    each = corner_Hz / sqrt(2.0**0.25 - 1.0)  # four first-order lags in all
    return exp(-2.0 * np.pi * each / rate_Hz)
