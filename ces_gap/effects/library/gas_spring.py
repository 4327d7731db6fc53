"""Gas spring: the gas force on the rod grows with compression; the simulation has another gas charge, or none.

A cell that was tared on the damper reads only the change of the gas force with stroke, another one all of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.effect import PARALLEL, Effect, EffectParameter, TwinRun, magnitude
from ces_gap.trace import Trace, TraceInputs

POLYTROPIC = 1.3  # exponent of nitrogen at stroke frequencies, between isothermal 1 and adiabatic 1.4
GAS_NODES, MIN_RATIO, MIN_PRESSURE = 15, 0.02, 0.05  # the latter relative to the reservoir's
MIN_COLUMN_SHARE = 0.15  # of the column: limit of compression

STIFFNESS = magnitude("stiffness_N_m", -20000.0, 40000.0, (800.0,), "real minus simulated stiffness at zero gas force")
COLUMN = EffectParameter("column_m", 0.05, 3.0, (0.15, 0.5), "gas volume over rod area at zero gas force", "log")
PRELOAD = magnitude("preload_N", -3000.0, 3000.0, (100.0,), "real minus simulated gas force at position zero")
CHARGED_COLUMN = EffectParameter("column_m", 0.05, 1.0, (0.15, 0.5), "gas volume over rod area at position zero", "log")


class GasSpring(Effect):
    name, stage = "gas_spring", PARALLEL
    summary = "gas pressure pushes the rod out"
    visible, mistaken_for = "over stroke, equally at any speed", ("bump_stop", "force_offset")
    bench = ("work", "mid_force_N")


class LinearGasSpring(GasSpring):
    """F + k x, zero at the zero of the position sensor, where the cell was tared."""

    form, needs = "linear", "different mean strokes, or slow strokes"
    parameters = (STIFFNESS,)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return force + values[0] * inputs.position


class Polytropic(GasSpring):
    """p V^n constant: F + k L/n ((1 - x/L)^-n - 1), k = n p0 A/L, zero at the zero of the position sensor.

    Source: Dixon 2007. 20 bar on a rod of 2.5 cm² above a column of 0.4 m gives 1.6 kN/m; air springs reach 40 kN/m.
    """

    form, needs = "polytropic", "long strokes, or different mean strokes"
    parameters = (STIFFNESS, COLUMN)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return force + values[0] * _per_stiffness(inputs.position, values[1])


class MeanCentredSpring(GasSpring):
    """As polytropic, but zero at the recording's mean position: for a sensor whose zero is elsewhere."""

    form, needs = "about_mean", "long strokes"
    parameters = (STIFFNESS, COLUMN)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        mean = float(np.mean(trace.inputs.position))
        return force + values[0] * _per_stiffness(inputs.position - mean, values[1])


class ChargedSpring(GasSpring):
    """The whole gas force, of a cell that was not tared: F + F0 (1 - x/L)^-n, F0 = p0 A, stiffness n F0/L.

    5 to 30 bar make 50 N to 1.2 kN, gas of 20 to 100 cm³ a column of 0.1 to 1 m.
    """

    form, needs = "charged", "long strokes"
    limit = "force_offset"
    parameters = (PRELOAD, CHARGED_COLUMN)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        preload, column = values
        return force + preload * (1.0 + POLYTROPIC / column * _per_stiffness(inputs.position, column))


class Charge(GasSpring):
    """Another gas charge: its force on the rod, and with it the pressure from which the chambers run empty.

    The force is F0 ((1 - x/L)^-n - 1), of a tared cell; the reservoir's pressure on the rod side's area grows by F0
    over the ratio of the areas.
    """

    form, edits, needs = "charge", True, "long strokes"
    parameters = (PRELOAD, CHARGED_COLUMN)

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        preload, column = values
        side, body = run.body.side, run.body
        at = np.linspace(side.position_m[0], side.position_m[-1], GAS_NODES)
        added = preload * POLYTROPIC / column * _per_stiffness(at, column)
        force = np.interp(at, side.position_m, side.gas_N) + added
        reservoir = body.reservoir_N + preload / max(body.area_ratio, MIN_RATIO)
        changed = replace(side, position_m=tuple(at.tolist()), gas_N=tuple(force.tolist()))
        return run.with_body(side=changed, reservoir_N=max(reservoir, MIN_PRESSURE * body.reservoir_N))


def _per_stiffness(position: F, column_m: float) -> F:
    """Return the polytropic force divided by the stiffness at zero [m] (n,)."""
    share = np.maximum(1.0 - position / column_m, MIN_COLUMN_SHARE)
    return np.asarray(column_m / POLYTROPIC * (share**-POLYTROPIC - 1.0))
