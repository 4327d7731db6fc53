"""Compiled loops of the effects with memory: one step per tick of a trace."""

from __future__ import annotations

from math import exp

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ces_gap.map_kernels import map_force_and_slope

F = NDArray[np.float64]

SAME_N = 1e-6  # [N] difference below which the force of a loose joint equals that of a tight one


@njit(cache=True, nogil=True, error_model="numpy")
def rise_fall_lag(u: F, rise_s: float, fall_s: float, step_s: float) -> F:
    """Return u (n,) behind a first-order lag with time constant `rise_s` upward and `fall_s` downward."""
    out = np.empty_like(u)
    z = u[0]
    out[0] = z
    for k in range(1, len(u)):
        z = _lag_step(z, u[k - 1], u[k], rise_s if u[k] > z else fall_s, step_s)
        out[k] = z
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _lag_step(z: float, before: float, now: float, time_s: float, step_s: float) -> float:
    """Return the lag's next state, its input linear from `before` to `now` (first-order hold)."""
    ratio = time_s / step_s
    if ratio < 1e-9:
        return now
    pole = exp(-1.0 / ratio)
    ramp = ratio * (1.0 - pole)
    return pole * z + (ramp - pole) * before + (1.0 - ramp) * now


@njit(cache=True, nogil=True, error_model="numpy")
def gated_play(x: F, openness: F, gap: float) -> F:
    """Return the position (n,) of a joint in its free play, within [-gap/2, gap/2], initially 0.

    It follows x (n,); the force limits the rate by `openness` (n,) towards +gap/2 (1: pushed in compression), and by
    1 - openness towards -gap/2.
    """
    out = np.empty_like(x)
    half = 0.5 * gap
    z = 0.0
    out[0] = z
    for k in range(1, len(x)):
        step = x[k] - x[k - 1]
        share = openness[k] if step > 0.0 else 1.0 - openness[k]
        z = min(max(z + share * step, -half), half)
        out[k] = z
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def mean_of_plays(u: F, widest: float, count: int) -> F:
    """Return the mean (n,) of `count` play operators of u, half-widths evenly up to `widest`, initially centred."""
    out = u.copy()
    for j in range(1, count + 1):
        radius = widest * j / count
        z = u[0]
        for k in range(len(u)):
            z = min(max(z, u[k] - radius), u[k] + radius)
            out[k] += (z - u[k]) / count
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def coleman_hodgdon(u: F, height: float, travel: float) -> F:
    """Return h (n,) of dh/du = -(height + h)/travel for rising u, (height - h)/travel for falling; h(0) = 0."""
    out = np.empty_like(u)
    h = 0.0
    out[0] = h
    for k in range(1, len(u)):
        step = u[k] - u[k - 1]
        target = -height if step > 0.0 else height
        h = target + (h - target) * exp(-abs(step) / travel)
        out[k] = h
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def tight_force(speed: F, level: F, plant: tuple[float, float, F], own: float, step_s: float, substeps: int) -> F:
    """Return the force [N] of F = f(v - own·dF/dt) by implicit Euler, f the map of `plant`, `substeps` per tick."""
    out = np.empty((len(speed) - 1) * substeps + 1)
    g = speed[0]
    out[0] = map_force_and_slope(g, level[0], plant[0], plant[1], plant[2])[0]
    for i in range(1, len(out)):
        k, w = (i - 1) // substeps, ((i - 1) % substeps + 1) / substeps
        v, s = speed[k] + w * (speed[k + 1] - speed[k]), level[k] + w * (level[k + 1] - level[k])
        g, out[i] = _solve_map_speed(v, s, out[i - 1], g, own * substeps / step_s, plant)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def loose_force(
    speed: F,
    level: F,
    memory: F,
    tight: F,
    gap: float,
    parted: float,
    plant: tuple[float, float, F],
    own: float,
    step_s: float,
    substeps: int,
) -> F:
    """Return the force [N] ((n - 1)·substeps + 1,) of a damper behind a joint with a gap, minus `memory`.

    The damper is f(v' - own·dF/dt) + memory, f the `map_force_and_slope` of `plant`; `tight` is its `tight_force`
    without a gap. The joint's position z stays at ±gap/2 while it is pushed or pulled; in between, the damper moves so
    that its force is `parted`. Implicit Euler.
    """
    out = np.empty((len(speed) - 1) * substeps + 1)
    h, half, z, g, creep = step_s / substeps, 0.5 * gap, 0.0, speed[0], 0.0
    force = tight[0]
    out[0] = force
    for i in range(1, len(out)):
        k, w = (i - 1) // substeps, ((i - 1) % substeps + 1) / substeps
        v, s = speed[k] + w * (speed[k + 1] - speed[k]), level[k] + w * (level[k + 1] - level[k])
        free = parted - memory[k] - w * (memory[k + 1] - memory[k])
        moved, touching = v, tight[i]
        if abs(force - tight[i - 1]) > SAME_N:
            moved, touching = _solve_map_speed(v, s, force, g, own / h, plant)
        if (touching < free or z < half) and (touching > free or z > -half):
            creep = _solve_speed_at_force(free, s, creep, plant)
            goal = min(max(z + h * (v - creep) - own * (free - force), -half), half)
            moved, touching = _solve_map_speed(v - (goal - z) / h, s, force, moved, own / h, plant)
            z = goal
        g, force = moved, touching
        out[i] = force
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _solve_map_speed(
    v: float, s: float, before: float, guess: float, own: float, plant: tuple[float, float, F]
) -> tuple[float, float]:
    """Return g [m/s] with g + own·(f(g) - before) = v, by bracketed Newton iteration, and f(g) [N]."""
    g, low, high = v, -np.inf, np.inf
    if own > 0.0:
        g = guess
        for _ in range(40):
            value, slope = map_force_and_slope(g, s, plant[0], plant[1], plant[2])
            wrong = v - g - own * (value - before)
            low, high = (g, high) if wrong > 0.0 else (low, g)
            move = wrong / (1.0 + own * slope)
            if not low < g + move < high and abs(low) < np.inf and abs(high) < np.inf:
                move = 0.5 * (low + high) - g
            g += move
            if abs(move) < 1e-9:
                break
    return g, map_force_and_slope(g, s, plant[0], plant[1], plant[2])[0]


@njit(cache=True, nogil=True, error_model="numpy")
def _solve_speed_at_force(force: float, s: float, guess: float, plant: tuple[float, float, F]) -> float:
    """Return the speed [m/s] at which f is `force` [N], within the map's range, by bracketed Newton iteration."""
    fastest = plant[0] * ((1.0 + plant[1]) ** 2 - 1.0)
    low, high = -fastest, fastest
    g = min(max(guess, low), high)
    for _ in range(40):
        value, slope = map_force_and_slope(g, s, plant[0], plant[1], plant[2])
        wrong = force - value
        low, high = (g, high) if wrong > 0.0 else (low, g)
        move = wrong / (slope + 1e-3)
        if not low < g + move < high:
            move = 0.5 * (low + high) - g
        g += move
        if abs(move) < 1e-9:
            break
    return g
