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


class SideSpecific(Compressibility):
    """Oil and chamber walls: ds/dF = 1/k of the side under pressure, k = β·A²/V; the valve sees the speed v - ds/dt.

    Source: flow continuity Q = A·v - (V/β)·dp/dt (Merritt, Hydraulic Control Systems, 1967), by chamber as in Duym,
    Vehicle System Dynamics 33 (2000). β about 1 GPa, A² / V of 1e-3 to 1e-2 m: 1e6 to 1e7 N/m; hoses and a little air
    make it ten times softer. Compression works on the rod's area, rebound on the annulus: their stiffnesses differ.
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
    """Bubbles: s = s₀·F/(|F| + F₀), isothermal gas of volume V₀ = A·s₀ compressed from p₀ = F₀/A; soft near zero force.

    Source: Boyle's law V = V₀·p₀/(p₀ + p), the free-air term of the effective bulk modulus in Merritt (1967). A few per
    cent of air in a chamber of 0.1 m make millimetres; p₀ of 1 to 10 bar on 1e-4 to 1e-3 m² makes 10 N to 1 kN.
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
    """Check valves change the stiffness: ds/dt = C·dF/dt, C = 1/`pumping_N_m` while pushed and moving in, else smaller.

    While the damper moves in, the piston's check valve is open and both chambers have one pressure, which acts on the
    rod's area only: k = β·A_rod²/(V₁ + V₂). When the motion reverses, the valve closes and each chamber acts on its
    own, much larger area: k = β·A²/V. Compression and release take different paths, so that s would drift: its slow
    part is not driven; instead the map's response to it is added. The plant's own spring, learnt from it, has the same
    two compliances. Source: continuity by chamber as above (Merritt 1967), for uniflow and monotube dampers.
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
