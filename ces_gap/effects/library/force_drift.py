"""Force drift: the zero of the cell drifts with time, as it warms or its glue creeps, independently of the damper."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.effect import CELL, Effect, EffectParameter, magnitude
from ces_gap.trace import Trace, TraceInputs


class ForceDrift(Effect):
    name, stage = "force_drift", CELL
    summary = "the zero of the force drifts"
    visible, mistaken_for = "with elapsed time", ("temperature_fade",)


class LinearDrift(ForceDrift):
    """F + r t, from a zero that is correct at the start of the recording.

    A 10 kN cell that warms by a kelvin per minute drifts by hundredths of a newton per second; gas that warms in the
    damper under hard work, by newtons per second.
    """

    form, needs = "linear", "at least some tens of seconds, tared at the start"
    parameters = (magnitude("drift_N_s", -1e3, 1e3, (0.5,), "drift of the zero", usual=(-20.0, 20.0)),)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return force + values[0] * trace.time_s


class SettlingDrift(ForceDrift):
    """F + A (1 - exp(-t/tau)), as a cell reaches its temperature or a charge leaks."""

    form, limit = "settling", "force_offset"
    needs = "a recording about as long as the drift lasts, tared at the start"
    parameters = (
        magnitude("settled_N", -1e5, 1e5, (20.0,), "drift after a long time", usual=(-2000.0, 2000.0)),
        EffectParameter("settling_s", 2.0, 500.0, (8.0, 60.0), "time constant of the drift", "log"),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return force - values[0] * np.expm1(-trace.time_s / values[1])
