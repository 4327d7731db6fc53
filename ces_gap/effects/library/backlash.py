"""Backlash: free play in a joint in series; after each force reversal the damper rests until the play is crossed."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, expm1, log1p

import numpy as np
from numba import njit

from ces_data.arrays import F
from ces_gap.effects.effect import MOTION, Effect, EffectParameter, magnitude
from ces_gap.grid import rms, thin_out
from ces_gap.plant_map import map_force_and_slope, remove_high_frequencies
from ces_gap.trace import Trace, TraceInputs

GAP = magnitude("gap_m", 0.0, 0.1, (5e-4, 2e-3), "total free play", usual=(0.0, 0.01))
SAME_N = 1e-6  # [N] difference below which the force of a loose joint equals that of a tight one
FAR = 30.0  # times the stroke of contact: room beyond which a joint is open
NEARLY = 0.99  # of the fastest speed of a map
SUBSTEP_S = 5e-4  # [s] of the integration: the joint separates and closes between ticks
SOFT = 0.03  # of the RMS force: width of its change of direction

MapTable = tuple[float, float, F]  # narrow, reach and table of `map_force_and_slope`


class Backlash(Effect):
    name, stage, needs = "backlash", MOTION, "reversals"
    summary = "free play in the linkage"
    visible, mistaken_for = "at reversals, for a fixed stroke", ("compressibility", "cavitation")

    @staticmethod
    def without_play(trace: Trace, inputs: TraceInputs, force: F, gap: float, contact: float) -> TraceInputs:
        """Return the motion of the damper whose joint is crossed once the force [N] (n,) has reversed."""
        acting = force - trace.learn_map(trace.inputs, force).rest(inputs.current)
        width = SOFT * rms(acting[trace.usable] if trace.usable.any() else acting) + 1e-3
        play = gated_play(inputs.position, 0.5 * (1.0 + np.tanh(acting / width)), gap, contact)
        return inputs.with_position(inputs.position - play, trace.rate_Hz)


class HeldPlay(Backlash):
    """Play z in [-gap/2, gap/2], crossed only once the force has reversed: x' = x - z, dz/dt = v, the damper rests.

    Source: play that separates at zero force (Nordin and Gutman, Automatica 38, 2002). Worn rod ends have tenths of a
    millimetre, linkages and brakes several.
    """

    form, reruns = "held", True
    parameters = (GAP,)

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        return self.without_play(trace, inputs, force, values[0], 0.0)


class SoftPlay(Backlash):
    """The same, but closing gradually: a stroke s from one side moves the damper by c·ln(1 + exp((s - gap)/c)).

    Contacts that close one after the other, and bands that tighten, carry their load gradually.
    """

    form, reruns = "soft", True
    parameters = (
        GAP,
        EffectParameter("softness", 0.01, 0.5, (0.05, 0.2), "stroke c of closing, over the play", "log"),
    )

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        return self.without_play(trace, inputs, force, values[0], values[1] * values[0])


class PartedPlay(Backlash):
    """The same, but the joint parts: meanwhile the damper creeps so that its force is `parted_N`, its gas force or 0 N.

    Its speed v' solves f(v' - c·dF/dt) + memory = `parted_N`, f and c learnt from the simulation (a map of speed and
    current behind its own spring).
    """

    form = "parted"
    parameters = (
        GAP,
        EffectParameter(
            "parted_N", -1e4, 1e4, (-20.0,), "reading of the cell while the joint is open", usual=(-500.0, 500.0)
        ),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        gap, level = values
        return force + change_by_joint(trace, inputs, force, (-0.5 * gap, 0.5 * gap), 0.0, level)


def change_by_joint(
    trace: Trace, inputs: TraceInputs, force: F, ends: tuple[float, float], start: float, level: float
) -> F:
    """Return the change of force [N] (n,) by a joint in series, at `start` between its `ends` [m] at first.

    While it is open the force is `level` [N]. The damper is a map of speed and current behind its own spring.
    """
    plant = trace.sprung_map
    substeps = int(np.ceil(trace.step_s / SUBSTEP_S - 1e-6))
    options = plant.map.kernel(), plant.compliance, trace.step_s, substeps
    motion = np.ascontiguousarray(inputs.speed), plant.map.level(inputs.current)
    tight = tight_force(*motion, *options)
    memory = remove_high_frequencies(force - tight[::substeps], trace.rate_Hz)
    return thin_out(loose_force(*motion, memory, tight, ends, start, level, *options) - tight, substeps)


@njit(cache=True, nogil=True, error_model="numpy")
def gated_play(x: F, openness: F, gap: float, contact: float = 0.0) -> F:
    """Return the position (n,) of a joint in its free play, within [-gap/2, gap/2], initially 0.

    It follows x (n,); the force limits the rate by `openness` (n,) towards +gap/2 (1: pushed in compression), and by
    1 - openness towards -gap/2. Within about `contact` [m] of its end it follows less and less.
    """
    out = np.empty_like(x)
    half = 0.5 * gap
    z = 0.0
    out[0] = z
    for k in range(1, len(x)):
        step = x[k] - x[k - 1]
        side = 1.0 if step > 0.0 else -1.0
        share = openness[k] if step > 0.0 else 1.0 - openness[k]
        z = side * (half - _close(half - side * z, share * abs(step), contact))
        out[k] = z
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _close(room: float, step: float, contact: float) -> float:
    """Return the room r [m] to the end of the play after a step s [m]: dr/ds = exp(-r/contact) - 1, exactly."""
    if room > FAR * contact + step:
        return room - step
    return contact * log1p(expm1(room / contact) * exp(-step / contact)) if contact > 0.0 else 0.0


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
    speed: F, level: F, memory: F, tight: F, ends: tuple[float, float], start: float, parted: float, plant: MapTable,
    own: float, step_s: float, substeps: int,
) -> F:  # fmt: skip
    """Return the force [N] ((n - 1)·substeps + 1,) of a damper behind a joint, minus `memory`.

    The damper is f(v' - own·dF/dt) + memory, f the `map_force_and_slope` of `plant`; `tight` is its `tight_force`
    without a joint. Its position z, first `start`, stays at an end while it is pushed to the upper or pulled to the
    lower one; in between, the damper moves so that its force is `parted`. Implicit Euler.
    """
    out = np.empty((len(speed) - 1) * substeps + 1)
    low, high = ends
    h, z, g, creep = step_s / substeps, start, speed[0], 0.0
    force = tight[0]
    out[0] = force
    for i in range(1, len(out)):
        k, w = (i - 1) // substeps, ((i - 1) % substeps + 1) / substeps
        v, s = speed[k] + w * (speed[k + 1] - speed[k]), level[k] + w * (level[k + 1] - level[k])
        free = parted - memory[k] - w * (memory[k + 1] - memory[k])
        moved, touching = v, tight[i]
        if abs(force - tight[i - 1]) > SAME_N:
            moved, touching = _solve_map_speed(v, s, force, g, own / h, plant)
        if (touching < free or z < high) and (touching > free or z > low):
            creep = _solve_speed_at_force(free, s, creep, plant)
            goal = min(max(z + h * (v - creep) - own * (free - force), low), high)
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
    """Return the speed [m/s] at which f is `force` [N], within the map's range, by bracketed Newton iteration.

    It begins at the `guess`, or at 0 where this is at the end of the range, beyond which the map may fall.
    """
    fastest = plant[0] * ((1.0 + plant[1]) ** 2 - 1.0)
    low, high = -fastest, fastest
    g = guess if abs(guess) < NEARLY * fastest else 0.0
    for _ in range(40):
        value, slope = map_force_and_slope(g, s, plant[0], plant[1], plant[2])
        g, low, high, move = move_in_bracket(g, low, high, force - value, slope + 1e-3)
        if abs(move) < 1e-9:
            break
    return g


@njit(cache=True, nogil=True, error_model="numpy")
def move_in_bracket(g: float, low: float, high: float, wrong: float, fall: float) -> tuple[float, float, float, float]:
    """Return g after a Newton step towards the root of a falling residual, its bracket ]low, high[, and the step.

    The residual is `wrong` at g and falls by `fall` per unit. A step out of a closed bracket halves it instead.
    """
    low, high = (g, high) if wrong > 0.0 else (low, g)
    move = wrong / fall
    if not low < g + move < high and abs(low) < np.inf and abs(high) < np.inf:
        move = 0.5 * (low + high) - g
    return g + move, low, high, move
