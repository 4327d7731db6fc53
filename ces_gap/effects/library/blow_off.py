"""Blow-off: a relief valve opens above a pressure, so that the force grows much less."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.effect import FLUID, Effect, EffectParameter, stiffness
from ces_gap.trace import Trace, TraceInputs

ROUNDING = 0.02  # of the level: width over which the valve opens
OPENS_AT = (0.97, 0.9, 0.75, 0.55)  # shares of the largest simulated force at which searches begin
REBOUND, COMPRESSION = (
    stiffness(f"{side}_N", 100.0, 100000.0, (800.0, 2000.0), f"force in {side} at which the valve opens")
    for side in ("rebound", "compression")
)
SLOPE = EffectParameter("slope", 0.0, 0.9, (0.2,), "slope of the force above the level, relative to no valve")


class BlowOff(Effect):
    """Above the level L of a valve, the force is L + s (F - L), rounded over 2 % of L.

    Source: relief valves (Dixon, The Shock Absorber Handbook, 2nd ed. 2007). They open at 0.5 to 5 kN; s is 0 for an
    ideal valve.
    """

    name, stage = "blow_off", FLUID
    summary, moves = "a relief valve opens and limits the force", ("flow map",)
    visible, mistaken_for = "only at the largest forces", ("leakage", "force_scale")
    sides: ClassVar[tuple[float, ...]] = ()

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        *levels, slope = values
        excess = sum(side * _excess(side * force, level) for side, level in zip(self.sides, levels, strict=True))
        return np.asarray(force - (1.0 - slope) * excess)

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        largest = [max(float(np.quantile(side * trace.simulated, 0.998)), 200.0) for side in self.sides]
        return [(*(share * force for force in largest), SLOPE.starts[0]) for share in OPENS_AT]


class ReboundBlowOff(BlowOff):
    """A valve that opens in rebound."""

    form, sides, needs = "rebound", (-1.0,), "rebound forces at which the real valve opens"
    parameters = (REBOUND, SLOPE)


class CompressionBlowOff(BlowOff):
    """A valve that opens in compression."""

    form, sides, needs = "compression", (1.0,), "compression forces at which the real valve opens"
    parameters = (COMPRESSION, SLOPE)


class TwoSidedBlowOff(BlowOff):
    """One valve for each direction, each with its level."""

    form, sides, needs = "both", (-1.0, 1.0), "forces at which the real valves open"
    parameters = (REBOUND, COMPRESSION, SLOPE)


def _excess(force: F, level: float) -> F:
    """Return the part of the force [N] (n,) above the level, rounded (softplus)."""
    if not np.isfinite(level):
        return np.zeros_like(force)
    width = ROUNDING * level
    return np.asarray(width * np.logaddexp(0.0, (force - level) / width))
