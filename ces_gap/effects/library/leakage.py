"""Leakage: flow through a worn seal, valve seat or bypass reduces the flow through the valve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.effect import FLUID, Effect, magnitude
from ces_gap.effects.series import Strain, high_pass_stroke, leaking_force, soft_width, subtract_stroke, tabulate_law
from ces_gap.grid import derivative
from ces_gap.plant_map import SprungMap
from ces_gap.trace import Trace, TraceInputs

SLOWEST_HZ = 0.1  # [Hz] below it the leaked stroke drifts


class _Leak(Effect):
    """The simulation is driven by v' = v - q(F), F being the force with the leak; forces at standstill drive no leak.

    F = f(v - q(F) - c·dF/dt), f the simulation's map with its own spring c, so spring forces relax through the leak.
    The slow part of q, which would make the stroke drift, acts through the map's response to it.
    """

    name, stage, reruns, needs = "leakage", FLUID, True, "motion in the direction that leaks"
    summary, moves = "oil bypasses the valves", ("flow map",)
    visible, mistaken_for = "at low speed, under high pressure", ("current_scale", "temperature_fade")

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        plant = trace.sprung_map
        acting = force - plant.rest
        width = soft_width(trace, acting)
        tight, leaking = (tabulate_law(q, acting, width) for q in (_no_leak, partial(self.leak, values)))
        change = _force_with_leak(trace, plant, inputs, leaking) - _force_with_leak(trace, plant, trace.inputs, tight)
        leak = self.leak(values, acting + change, width)[0]
        return subtract_stroke(inputs, _integrate_fast_part(leak, trace), trace.rate_Hz)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        plant = trace.sprung_map
        width = soft_width(trace, force - plant.rest)
        tight = tabulate_law(_no_leak, force - plant.rest, width)
        slow = self._slow(trace, force - plant.rest, width, values)  # the leak depends on the force that it changes
        slower = plant.map.force(inputs.speed - slow, inputs.current) - plant.map.force(inputs.speed, inputs.current)
        slow = self._slow(trace, force + slower - plant.rest, width, values)
        moved = replace(inputs, speed=inputs.speed - slow)
        return force + _force_with_leak(trace, plant, moved, tight) - _force_with_leak(trace, plant, inputs, tight)

    def _slow(self, trace: Trace, acting: F, width: float, values: Sequence[float]) -> F:
        """Return the slow part [m/s] (n,) of the leak."""
        leak = self.leak(values, acting, width)[0]
        return leak - derivative(_integrate_fast_part(leak, trace), trace.rate_Hz)

    def leak(self, values: Sequence[float], force: F, width: float) -> Strain:
        """Return the speed [m/s] (n,) of the leak at a force [N] (n,) and its derivative by force."""
        raise NotImplementedError


def _no_leak(force: F, width: float) -> Strain:
    return np.zeros_like(force), np.zeros_like(force)


def _force_with_leak(trace: Trace, plant: SprungMap, inputs: TraceInputs, law: tuple[float, F, F]) -> F:
    """Return the force [N] (n,) of the map with its spring and a tabulated leak, minus that at standstill."""
    top, rate, per_force = law
    own = plant.compliance * trace.rate_Hz
    whole = (top, rate + own * np.linspace(-top, top, len(rate)), per_force + own)
    speed, level = np.ascontiguousarray(inputs.speed), plant.map.level(inputs.current)
    return np.asarray(leaking_force(speed, level, plant.rest, plant.map.kernel(), own, whole))


def _integrate_fast_part(speed: F, trace: Trace) -> F:
    """Return the stroke [m] (n,) of a speed without its slow part."""
    return high_pass_stroke(np.cumsum(speed) * trace.step_s, trace, SLOWEST_HZ)


class ReboundLeak(_Leak):
    """A narrow annular gap under rebound pressure: q = κ·F for F < 0.

    Source: laminar leakage Q = C·Δp (Merritt 1967). At 1 kN and 0.3 m/s, 1e-5 m/(s N) is a leak of 3 %.
    """

    form = "rebound"
    parameters = (magnitude("leak_m_sN", 0.0, 5e-4, (1e-5, 5e-5), "leaking speed per newton, rebound"),)

    def leak(self, values: Sequence[float], force: F, width: float) -> Strain:
        root = np.sqrt(force**2 + width**2)
        return 0.5 * values[0] * (force - root + width), 0.5 * values[0] * (1.0 - force / root)


class TwoWayLeak(_Leak):
    """A gap that leaks in both directions: q = κ·F."""

    form = "both"
    parameters = (magnitude("leak_m_sN", 0.0, 5e-4, (1e-5, 5e-5), "leaking speed per newton"),)

    def leak(self, values: Sequence[float], force: F, width: float) -> Strain:
        return values[0] * force, np.full_like(force, values[0])


class Orifice(_Leak):
    """A hole, or a valve held open by dirt: q = κ·√|F|·sign F, κ by direction, laminar near zero force.

    Source: Q = C_d·A_o·√(2Δp/ρ) (Merritt 1967). A hole of 0.1 mm² past a piston of 5 cm² leaks 0.01 m/s at 1 kN.
    """

    form = "orifice"
    parameters = (
        magnitude("rebound_m_s_rtN", 0.0, 0.02, (5e-4, 3e-3), "leaking speed per √newton, rebound"),
        magnitude("compression_m_s_rtN", 0.0, 0.02, (5e-4, 0.0), "the same in compression"),
    )

    def leak(self, values: Sequence[float], force: F, width: float) -> Strain:
        mean, lean = 0.5 * (values[1] + values[0]), 0.5 * (values[1] - values[0])
        square, side = force**2 + width**2, np.tanh(force / width)
        through, per_force = force / square**0.25, (0.5 * force**2 + width**2) / square**1.25
        turning = lean * (1.0 - side**2) / width * through
        return (mean + lean * side) * through, (mean + lean * side) * per_force + turning
