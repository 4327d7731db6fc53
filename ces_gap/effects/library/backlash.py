"""Backlash: free play in a joint in series; after each force reversal the damper rests until the play is crossed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from ces_data.arrays import F
from ces_gap.effects.effect import MOTION, Effect, EffectParameter, magnitude
from ces_gap.effects.series import MapTable, move_in_bracket, soft_width, subtract_stroke
from ces_gap.grid import thin_out
from ces_gap.plant_map import map_force_and_slope, remove_high_frequencies
from ces_gap.trace import Trace, TraceInputs

GAP = magnitude("gap_m", 0.0, 0.01, (5e-4, 2e-3), "total free play")
SAME_N = 1e-6  # [N] difference below which the force of a loose joint equals that of a tight one
SUBSTEP_S = 5e-4  # [s] of the integration: the joint separates and closes between ticks


class Backlash(Effect):
    name, stage, needs = "backlash", MOTION, "reversals"
    summary, moves = "free play in the linkage", ("elasticity",)
    visible, mistaken_for = "at reversals, for a fixed stroke", ("compressibility", "cavitation")


class HeldPlay(Backlash):
    """Play z in [-gap/2, gap/2], crossed only once the force has reversed: x' = x - z, dz/dt = v, the damper rests.

    Source: play that separates at zero force (Nordin and Gutman, Automatica 38, 2002). Worn rod ends have tenths of a
    millimetre, linkages and brakes several.
    """

    form, reruns = "held", True
    parameters = (GAP,)

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        acting = force - trace.learn_map(trace.inputs, force).rest(inputs.current)
        pushed = 0.5 * (1.0 + np.tanh(acting / soft_width(trace, acting)))
        return subtract_stroke(inputs, gated_play(inputs.position, pushed, values[0]), trace.rate_Hz)


class PartedPlay(Backlash):
    """The same, but the joint parts: meanwhile the damper creeps so that its force is `parted_N`, its gas force or 0 N.

    Its speed v' solves f(v' - c·dF/dt) + memory = `parted_N`, f and c learnt from the simulation (a map of speed and
    current behind its own spring). The effect is the resulting change of the map's force.
    """

    form = "parted"
    parameters = (
        GAP,
        EffectParameter("parted_N", -500.0, 500.0, (-20.0,), "reading of the cell while the joint is open"),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        plant, (gap, level) = trace.sprung_map, values
        substeps = int(np.ceil(trace.step_s / SUBSTEP_S - 1e-6))
        options = plant.map.kernel(), plant.compliance, trace.step_s, substeps
        motion = np.ascontiguousarray(inputs.speed), plant.map.level(inputs.current)
        tight = tight_force(*motion, *options)
        memory = remove_high_frequencies(force - tight[::substeps], trace.rate_Hz)
        return force + thin_out(loose_force(*motion, memory, tight, gap, level, *options) - tight, substeps)


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
def tight_force(speed: F, level: F, plant: MapTable, own: float, step_s: float, substeps: int) -> F:
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
    speed: F, level: F, memory: F, tight: F, gap: float, parted: float, plant: MapTable, own: float, step_s: float,
    substeps: int,
) -> F:  # fmt: skip
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
    v: float, s: float, before: float, guess: float, own: float, plant: MapTable
) -> tuple[float, float]:
    """Return g [m/s] with g + own·(f(g) - before) = v, by bracketed Newton iteration, and f(g) [N]."""
    g, low, high = v, -np.inf, np.inf
    if own > 0.0:
        g = guess
        for _ in range(40):
            value, slope = map_force_and_slope(g, s, plant[0], plant[1], plant[2])
            g, low, high, move = move_in_bracket(g, low, high, v - g - own * (value - before), 1.0 + own * slope)
            if abs(move) < 1e-9:
                break
    return g, map_force_and_slope(g, s, plant[0], plant[1], plant[2])[0]


@njit(cache=True, nogil=True, error_model="numpy")
def _solve_speed_at_force(force: float, s: float, guess: float, plant: MapTable) -> float:
    """Return the speed [m/s] at which f is `force` [N], within the map's range, by bracketed Newton iteration."""
    fastest = plant[0] * ((1.0 + plant[1]) ** 2 - 1.0)
    low, high = -fastest, fastest
    g = min(max(guess, low), high)
    for _ in range(40):
        value, slope = map_force_and_slope(g, s, plant[0], plant[1], plant[2])
        g, low, high, move = move_in_bracket(g, low, high, force - value, slope + 1e-3)
        if abs(move) < 1e-9:
            break
    return g
