"""Leakage: a worn seal, valve seat or bypass lets flow past the valve, which sees less speed than the piston has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_gap.effect import FLUID, Effect, Parameter
from ces_gap.series_kernels import leaking_force
from ces_gap.series_strain import Law, Strain, soft_width, tabled
from ces_gap.speed_map import learn_map
from ces_gap.trace import Inputs, Trace

F = NDArray[np.float64]


@dataclass(frozen=True)
class _Leak(Effect):
    """Solves F = f(v - q(F)), f being the plant: F = F₀ + f̂(v - q) - f̂(v) with its map f̂ of speed and current.

    Not done by moving the position: what leaks in one direction would make the stroke wander. The force at standstill
    drives no leak.
    """

    name, stage, needs = "leakage", FLUID, "motion in the direction that leaks"

    def respond(self, trace: Trace, inputs: Inputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] with the leak."""
        plant = learn_map(trace, inputs, force)
        rest = plant.rest(inputs.current)
        acting = force - rest
        memory = acting - plant.force(inputs.speed, inputs.current)
        law = tabled(self.law(values), acting, soft_width(trace, acting))
        level, speed = plant.level(inputs.current), np.ascontiguousarray(inputs.speed)
        return np.asarray(leaking_force(speed, level, memory, plant.kernel(), law) + rest)

    def law(self, values: Sequence[float]) -> Law:
        """Return the speed [m/s] that leaks at a force, and its derivative."""
        raise NotImplementedError


@dataclass(frozen=True)
class ReboundLeak(_Leak):
    """A narrow annular gap past the piston under rebound pressure: q = κ·F for F < 0.

    Source: laminar leakage Q = C·Δp (Merritt, Hydraulic Control Systems, 1967). At 1 kN and 0.3 m/s, 1e-5 m/(s N) is a
    leak of 3 % and 3e-4 nearly everything.
    """

    form = "rebound"
    parameters = (
        Parameter("leak_m_sN", 0.0, 5e-4, (1e-5, 5e-5), "speed that leaks per newton of rebound", magnitude=True),
    )

    def law(self, values: Sequence[float]) -> Law:
        """Return the leaking speed, laminar, in rebound only."""
        leak = values[0]

        def rebound(force: F, width: float) -> Strain:
            root = np.sqrt(force**2 + width**2)
            return Strain(0.5 * leak * (force - root + width), 0.5 * leak * (1.0 - force / root))

        return rebound


@dataclass(frozen=True)
class BothWays(_Leak):
    """A gap that leaks alike in both directions: q = κ·F. Source and range as for rebound."""

    form = "both"
    parameters = (Parameter("leak_m_sN", 0.0, 5e-4, (1e-5, 5e-5), "speed that leaks per newton", magnitude=True),)

    def law(self, values: Sequence[float]) -> Law:
        """Return the leaking speed, laminar."""
        leak = values[0]
        return lambda force, width: Strain(leak * force, np.full_like(force, leak))


@dataclass(frozen=True)
class Orifice(_Leak):
    """A hole or a valve held open by dirt: q = κ·√|F|·sign F, by direction, laminar near no force.

    Source: turbulent orifice Q = C_d·A_o·√(2Δp/ρ) (Merritt 1967). A hole of 0.1 mm² past a piston of 5 cm² leaks
    0.01 m/s at 1 kN (3e-4 m/(s·√N)); ten holes lose 0.1 m/s.
    """

    form = "orifice"
    parameters = (
        Parameter("rebound_m_s_rtN", 0.0, 0.02, (5e-4, 3e-3), "leaking speed per √newton, rebound", magnitude=True),
        Parameter("compression_m_s_rtN", 0.0, 0.02, (5e-4, 0.0), "the same in compression", magnitude=True),
    )

    def law(self, values: Sequence[float]) -> Law:
        """Return the leaking speed, turbulent."""
        mean, lean = 0.5 * (values[1] + values[0]), 0.5 * (values[1] - values[0])

        def orifice(force: F, width: float) -> Strain:
            square, side = force**2 + width**2, np.tanh(force / width)
            through, per_force = force / square**0.25, (0.5 * force**2 + width**2) / square**1.25
            turning = lean * (1.0 - side**2) / width * through
            return Strain((mean + lean * side) * through, (mean + lean * side) * per_force + turning)

        return orifice


FORMS = (ReboundLeak(), BothWays(), Orifice())
