"""Compressibility: oil, hoses and bubbles store volume, so that force builds up late, differently in each direction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.effect import FLUID, EffectParameter, magnitude, stiffness
from ces_gap.effects.series import SeriesSpring, Strain, high_pass_stroke, pumped_stroke, subtract_stroke
from ces_gap.grid import derivative
from ces_gap.trace import Trace, TraceInputs

SLOWEST_HZ = 0.2  # [Hz] below it the compressed stroke drifts
PUMPED_SUBSTEPS = 2


class Compressibility(SeriesSpring):
    name, stage = "compressibility", FLUID
    needs = "motion fast enough to change the force within tens of milliseconds"
    summary, moves = "oil, hoses and bubbles are elastic", ("elasticity",)
    visible, mistaken_for = "as force builds up, differently in each direction", ("mount_compliance", "position_delay")


class SideSpecific(Compressibility):
    """Oil and walls: the simulation is driven by x - s, s = F/k, with k = β·A²/V of the side under pressure.

    Source: continuity Q = A·v - (V/β)·dp/dt (Merritt 1967), by chamber as in Duym 2000. Oil makes 1e6 to 1e7 N/m; hoses
    and a little air make it ten times softer.
    """

    form = "sides"
    parameters = (
        stiffness("compression_N_m", 5e4, 1e9, (1e6, 1e7, 3e6), "stiffness in compression"),
        stiffness("rebound_N_m", 5e4, 1e9, (3e6, 1e6), "stiffness in rebound"),
    )

    def strain(self, force: F, width: float, values: Sequence[float]) -> Strain:
        mean = 0.5 * (1.0 / values[0] + 1.0 / values[1])
        lean = 0.5 * (1.0 / values[0] - 1.0 / values[1])
        ratio = force / width
        stroke = mean * force + lean * width * (np.logaddexp(ratio, -ratio) - np.log(2.0))
        return stroke, mean + lean * np.tanh(ratio)


class AeratedOil(Compressibility):
    """Bubbles: s = s₀·F/(|F| + F₀), gas of volume A·s₀ compressed from the pressure F₀/A; soft near zero force.

    Source: Boyle's law, as in the effective bulk modulus of Merritt 1967. A few per cent of air make millimetres.
    """

    form = "aerated"
    parameters = (
        magnitude("compression_void_m", 0.0, 0.02, (1e-3, 2e-4, 5e-3), "bubbles under compression, as a stroke"),
        magnitude("rebound_void_m", 0.0, 0.02, (1e-3,), "bubbles under rebound, as a stroke"),
        EffectParameter("pressure_N", 10.0, 1000.0, (100.0, 500.0), "force that halves the bubbles", "log"),
    )

    def strain(self, force: F, width: float, values: Sequence[float]) -> Strain:
        mean, lean, half = 0.5 * (values[0] + values[1]), 0.5 * (values[0] - values[1]), values[2]
        side = np.tanh(force / width)
        void, rounded = mean + lean * side, float(np.hypot(half, width))
        room = np.abs(force) + rounded
        steep = void * rounded / room**2 + lean * (1.0 - side**2) / width * force / room
        return void * force / room, np.maximum(steep, 0.0)


class CheckValveStiffness(Compressibility):
    """Check valves: ds/dt = C·dF/dt, C = 1/`pumping_N_m` while pushed and moving in, else 1/`other_N_m`.

    While the damper moves in, the check valve is open and one pressure acts on the rod's area only. Source: continuity
    by chamber (Merritt 1967). The slow part of s, which would drift, acts through the map's response to it.
    """

    form = "pumped"
    parameters = (
        stiffness("pumping_N_m", 5e4, 1e9, (2e6, 1e7), "stiffness while pushed and moving in"),
        stiffness("other_N_m", 5e4, 1e9, (2e7,), "stiffness otherwise"),
    )

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        return subtract_stroke(inputs, high_pass_stroke(self._stroke(trace, values), trace, SLOWEST_HZ), trace.rate_Hz)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        stroke, plant = self._stroke(trace, values), trace.pumped_map.map
        slow = derivative(stroke - high_pass_stroke(stroke, trace, SLOWEST_HZ), trace.rate_Hz)
        return force + plant.force(inputs.speed - slow, inputs.current) - plant.force(inputs.speed, inputs.current)

    def _stroke(self, trace: Trace, values: Sequence[float]) -> F:
        plant = trace.pumped_map
        added, inputs = (1.0 / values[0], 1.0 / values[1]), trace.inputs
        speed, level = np.ascontiguousarray(inputs.speed), plant.map.level(inputs.current)
        options = plant.map.kernel(), plant.own, added, plant.widths, trace.step_s, PUMPED_SUBSTEPS
        return np.asarray(pumped_stroke(speed, level, plant.memory, *options))
