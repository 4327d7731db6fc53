"""A spring in series with the damper: its stroke, solved together with the slope of the damper.

The spring's stroke z obeys z = s(F), and the damper moves at the speed v - dz/dt; the map of speed and current gives
its force at that speed. (Using the force F₀ without the spring, z = s(F₀), diverges if the damper is steep near
standstill.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.signal import butter, sosfiltfilt

from ces_data.arrays import F
from ces_gap.effects.series_kernels import series_stroke
from ces_gap.grid import derivative, rms
from ces_gap.plant_map import remove_high_frequencies
from ces_gap.trace import Trace, TraceInputs

SOFT = 0.03  # of the RMS force: width of the change between the laws of the two directions
SUBSTEP_S = 2.1e-3  # [s] longest step of the integration
NODES = 4001  # of a tabulated law
BEYOND = 3.0  # times the largest force: range of a tabulated law


@dataclass(frozen=True)
class Strain:
    """Stroke [m] (n,) and compliance [m/N] (n,) of a spring at a force."""

    stroke: F
    compliance: F


Law = Callable[[F, float], Strain]  # damping force [N] (n,), width [N] of the change of direction -> strain


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


def tabulate_law(law: Law, force: F, width: float) -> tuple[float, F, F]:
    """Return the range ±top [N], strokes and compliances of an even table of the law that covers `force` (n,)."""
    top = BEYOND * float(np.max(np.abs(force))) + 1.0
    strain = law(np.linspace(-top, top, NODES), width)
    return top, strain.stroke, strain.compliance


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
