"""A spring in series with the damper: the stroke it takes, solved together with the damper's own steepness.

The spring's stroke z obeys z = s(F), and the damper feels the speed v - dz/dt. How the plant answers to that speed is
told by its map of speed and current. (To put in the force of the unmoved damper, z = s(F₀), diverges for any damper
that is steep near standstill.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ces_gap.derivative import derivative
from ces_gap.effects.series_kernels import series_stroke
from ces_gap.plant_map.own_spring import remove_high_frequencies
from ces_gap.trace import F, Trace, TraceInputs

SOFT = 0.03  # of the force's RMS: width of the change from one direction's law to the other's
SUBSTEP_S = 2.1e-3  # [s] longest step of the integration
NODES = 4001  # of a law's table
BEYOND = 3.0  # times the largest force: how far a law is tabled


@dataclass(frozen=True)
class Strain:
    """A spring's stroke [m] (n,) at a force and its compliance [m/N] (n,) there."""

    stroke: F
    compliance: F


Law = Callable[[F, float], Strain]  # damping force [N] (n,), width [N] of the change of direction -> strain


def subtract_spring_stroke(
    trace: Trace, inputs: TraceInputs, force: F, law: Law, damping_s: float = 0.0
) -> TraceInputs:
    """Return the inputs with the stroke that a series spring takes subtracted.

    `force` [N] (n,) is the plant's under `trace.inputs`; what it is at standstill strains nothing. `damping_s` is the
    spring's own relaxation time.
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


def tabulate_law(law: Law, force: F, width: float) -> tuple[float, F, F]:
    """Return ±N [N] of an even table of the law, and its strokes and compliances, for forces such as `force` (n,)."""
    top = BEYOND * float(np.max(np.abs(force))) + 1.0
    strain = law(np.linspace(-top, top, NODES), width)
    return top, strain.stroke, strain.compliance


def subtract_stroke(inputs: TraceInputs, stroke: F, rate_Hz: float) -> TraceInputs:
    """Return the inputs with a stroke [m] (n,) subtracted from the position, and its rate from the speed."""
    return replace(inputs, position=inputs.position - stroke, speed=inputs.speed - derivative(stroke, rate_Hz))


def soft_width(trace: Trace, force: F) -> float:
    """Return `SOFT` of the force's RMS [N] over the usable ticks, never nothing."""
    used = force[trace.usable] if trace.usable.any() else force
    return SOFT * float(np.sqrt(np.mean(used**2))) + 1e-3
