"""A spring or a leak in series with the damper, solved together with the slope of the damper.

The spring's stroke z obeys z = s(F), and the damper moves at the speed v - dz/dt; the map of speed and current gives
its force at that speed. (Using the force F₀ without the spring, z = s(F₀), diverges if the damper is steep near
standstill.) The compiled loops of all effects that act so follow at the end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from math import tanh

import numpy as np
from numba import njit
from scipy.signal import butter, sosfiltfilt

from ces_data.arrays import F
from ces_gap.effects.effect import Effect
from ces_gap.grid import derivative, rms
from ces_gap.plant_map import map_force_and_slope, remove_high_frequencies
from ces_gap.trace import Trace, TraceInputs

SOFT = 0.03  # of the RMS force: width of the change between the laws of the two directions
SUBSTEP_S = 2.1e-3  # [s] longest step of the integration
NODES = 4001  # of a tabulated law
BEYOND = 3.0  # times the largest force: range of a tabulated law
THETA = 0.55  # of an implicit step: 0.5 is second-order accurate but rings, 1 is damped but lags
RATE_TOLERANCE = 1e-5  # [m/s] last step of the Newton iteration; the remaining error is of second order in it


Strain = tuple[F, F]  # stroke [m] (n,) of a spring and its compliance [m/N] (n,); of a leak [m/s], [m/(s N)]
Law = Callable[[F, float], Strain]  # damping force [N] (n,), width [N] of the change of direction -> strain
LawTable = tuple[float, F, F]  # top, stroke and compliance, or rate and its derivative by force: `tabulate_law`
MapTable = tuple[float, float, F]  # narrow, reach and table of `map_force_and_slope`
Pair = tuple[float, float]


class SeriesSpring(Effect):
    """An effect that is a spring between sensor and piston: the simulation is driven without its stroke."""

    reruns = True

    def strain(self, force: F, width: float, values: Sequence[float]) -> Strain:
        """Return the law of the spring; `width` [N] is that of the change between the laws of the two directions."""
        raise NotImplementedError

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        """Return the motion of the damper."""
        return subtract_spring_stroke(trace, inputs, force, lambda acting, width: self.strain(acting, width, values))


def subtract_spring_stroke(
    trace: Trace, inputs: TraceInputs, force: F, law: Law, damping_s: float = 0.0
) -> TraceInputs:
    """Return the inputs minus the stroke of a series spring with relaxation time `damping_s`.

    `force` [N] (n,) is the plant's for `trace.inputs`; its value at standstill does not strain the spring.
    """
    plant = trace.learn_map(trace.inputs, force)
    static = plant.force(trace.inputs.speed, trace.inputs.current)
    memory = remove_high_frequencies(force - static, trace.rate_Hz) - plant.rest(trace.inputs.current)
    acting = static + memory
    stroke = series_stroke(
        np.ascontiguousarray(inputs.speed),
        plant.level(inputs.current),
        memory,
        plant.kernel(),
        tabulate_law(law, acting, soft_width(trace, acting)),
        damping_s,
        trace.step_s,
        int(np.ceil(trace.step_s / SUBSTEP_S)),
    )
    return subtract_stroke(inputs, stroke, trace.rate_Hz)


def tabulate_law(law: Law, force: F, width: float) -> LawTable:
    """Return the range ±top [N], strokes and compliances of an even table of the law that covers `force` (n,)."""
    top = BEYOND * float(np.max(np.abs(force))) + 1.0
    return top, *law(np.linspace(-top, top, NODES), width)


def subtract_stroke(inputs: TraceInputs, stroke: F, rate_Hz: float) -> TraceInputs:
    """Return the inputs minus a stroke [m] (n,) in position and speed."""
    return replace(inputs, position=inputs.position - stroke, speed=inputs.speed - derivative(stroke, rate_Hz))


def soft_width(trace: Trace, force: F) -> float:
    """Return the width [N] of the change of direction: `SOFT` of the RMS force on usable ticks, above 0."""
    used = force[trace.usable] if trace.usable.any() else force
    return SOFT * rms(used) + 1e-3


def high_pass_stroke(stroke: F, trace: Trace, slowest_Hz: float) -> F:
    """Return the stroke [m] (n,) behind a high-pass at `slowest_Hz` without delay."""
    sos = _design_high_pass(slowest_Hz, trace.rate_Hz)
    return np.asarray(sosfiltfilt(sos, stroke, padlen=min(len(stroke) - 1, round(trace.rate_Hz))))


@cache
def _design_high_pass(slowest_Hz: float, rate_Hz: float) -> F:
    """Return the second-order sections (1, 6) of a first-order Butterworth high-pass."""
    return np.asarray(butter(1, slowest_Hz, "high", fs=rate_Hz, output="sos"))


@njit(cache=True, nogil=True, error_model="numpy")
def _law(force: float, top: float, stroke: F, compliance: F) -> tuple[float, float]:
    """Return stroke and compliance of a law tabulated evenly over ±`top` [N], by cubic Hermite interpolation."""
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
    v: float, s: float, m: float, z: float, guess: float, plant: MapTable, law: LawTable, inertia_s: Pair
) -> float:
    """Return the rate g [m/s] with s(f(v - g) + m) = z + (hθ + damping)·g, by bracketed Newton iteration.

    The residual decreases with g, so there is one root.
    """
    g, low, high = guess, -np.inf, np.inf
    whole = inertia_s[0] + inertia_s[1]
    for _ in range(40):
        value, slope = map_force_and_slope(v - g, s, plant[0], plant[1], plant[2])
        stroke, compliance = _law(value + m, law[0], law[1], law[2])
        wrong = stroke - z - whole * g
        g, low, high, move = move_in_bracket(g, low, high, wrong, compliance * slope + whole)
        if abs(move) < RATE_TOLERANCE:
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


@njit(cache=True, nogil=True, error_model="numpy")
def series_stroke(
    speed: F, level: F, memory: F, plant: MapTable, law: LawTable, damping_s: float, step_s: float, substeps: int
) -> F:
    """Return the stroke z [m] (n,) of a spring in series: z + damping·dz/dt = s(f(v - dz/dt) + memory).

    `plant` is (narrow, reach, table) of `map_force_and_slope`, `law` (top, stroke, compliance) of s. Implicit
    θ-method.
    """
    out = np.empty_like(speed)
    h = step_s / substeps
    force = map_force_and_slope(speed[0], level[0], plant[0], plant[1], plant[2])[0] + memory[0]
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
def leaking_force(speed: F, level: F, rest: float, plant: MapTable, own: float, law: LawTable) -> F:
    """Return F = f(v - g) - rest [N] (n,), g = q(F) + own·(F - F₋₁) [m/s]: the leak and the plant's own spring.

    `plant` is (narrow, reach, table) of `map_force_and_slope`, `own` the compliance of the plant's own spring divided
    by the step [m/(s N)], F₋₁ the force one tick before. `law` (top, rate, its derivative by force) is of q(F) + own·F.
    Implicit Euler.
    """
    out = np.empty_like(speed)
    g = 0.0
    force = map_force_and_slope(speed[0], level[0], plant[0], plant[1], plant[2])[0] - rest
    for k in range(len(speed)):
        g = _strain_rate(speed[k], level[k], -rest, own * force, g, plant, law, (1.0, 0.0))
        force = map_force_and_slope(speed[k] - g, level[k], plant[0], plant[1], plant[2])[0] - rest
        out[k] = force
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def pumped_stroke(
    speed: F, level: F, memory: F, plant: MapTable, own: Pair, added: Pair, widths: Pair, step_s: float, substeps: int
) -> F:
    """Return the stroke z [m] (n,), dz/dt = C·dF/dt, of a compliance C in addition to the plant's own spring.

    `own` and `added` are compliances [m/N] while the damper is pushed and moves in, and otherwise; `widths` [N], [m/s]
    smooth the change. F = f(v - (C + own)·df/dt - C·dm/dt) + memory m. Implicit Euler.
    """
    out = np.zeros_like(speed)
    h, g, z = step_s / substeps, 0.0, 0.0
    force = map_force_and_slope(speed[0], level[0], plant[0], plant[1], plant[2])[0]
    for i in range(1, (len(speed) - 1) * substeps + 1):
        k, w = (i - 1) // substeps, ((i - 1) % substeps + 1) / substeps
        v, s = speed[k] + w * (speed[k + 1] - speed[k]), level[k] + w * (level[k + 1] - level[k])
        rise = memory[k + 1] - memory[k]
        pumping = pumping_share(force + memory[k] + w * rise, v, widths)
        own_c = own[1] + pumping * (own[0] - own[1])
        added_c = added[1] + pumping * (added[0] - added[1])
        before = force - added_c * rise / substeps / max(own_c + added_c, 1e-15)
        g, now = _solve_squeeze_rate(v, s, before, g, (own_c + added_c) / h, plant)
        z += added_c * (now - force + rise / substeps)
        force = now
        out[k + 1] = z
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def pumping_share(force: float, speed: float, widths: Pair) -> float:
    """Return the degree, 0 to 1, to which a damper is pushed and moves in."""
    return 0.25 * (1.0 + tanh(force / widths[0])) * (1.0 + tanh(speed / widths[1]))


@njit(cache=True, nogil=True, error_model="numpy")
def _solve_squeeze_rate(
    v: float, s: float, before: float, guess: float, whole: float, plant: MapTable
) -> tuple[float, float]:
    """Return g [m/s] = whole·(f(v - g) - before), by bracketed Newton iteration, and the force f [N]."""
    g, low, high = guess, -np.inf, np.inf
    for _ in range(40):
        value, slope = map_force_and_slope(v - g, s, plant[0], plant[1], plant[2])
        g, low, high, move = move_in_bracket(g, low, high, whole * (value - before) - g, whole * slope + 1.0)
        if abs(move) < RATE_TOLERANCE:
            break
    return g, map_force_and_slope(v - g, s, plant[0], plant[1], plant[2])[0]
