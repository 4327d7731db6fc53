"""Blow-off: a relief valve opens above a pressure, so that the force grows much less."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.effect import FLUID, Effect, EffectParameter, TwinRun, magnitude
from ces_gap.trace import Trace

OPENS_AT = (0.97, 0.9, 0.75, 0.55)  # shares of the largest simulated force at which searches begin
WIDE, AT = 0.05, (-6.0, -4.0, -2.0, -1.0, 0.0, 1.0, 2.0, 4.0, 6.0)  # width over the level, and nodes in widths
REBOUND, COMPRESSION = (
    EffectParameter(f"{side}_N", 100.0, 1e6, (800.0,), f"pressure drop in {side} at which the valve opens", "log")
    for side in ("rebound", "compression")
)
OPENING = magnitude("opening_m_sN", 0.0, 0.1, (1e-4,), "growth of the valve's flow with the drop")


class BlowOff(Effect):
    """Inside the damper: a valve between the chambers opens beyond a drop P, q = κ w ln(1 + exp((Δp - P)/w)).

    Source: relief valves (Dixon, The Shock Absorber Handbook, 2nd ed. 2007). They open at 0.5 to 5 kN.
    """

    name, stage = "blow_off", FLUID
    summary = "a relief valve opens and limits the force"
    visible, mistaken_for = "only at the largest forces", ("leakage", "force_scale")
    sides: ClassVar[tuple[float, ...]] = ()

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        *levels, opening = values
        drops = [side * level * (1.0 + WIDE * at) for side, level in zip(self.sides, levels, strict=True) for at in AT]

        def relieve(flow: F, drop: F) -> F:
            for side, level in zip(self.sides, levels, strict=True):
                width = WIDE * level
                past = np.logaddexp(0.0, (side * drop - level) / width) - np.logaddexp(0.0, -level / width)
                flow = flow + side * opening * width * past
            return flow

        return run.with_flow("piston", relieve, drops)

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        force, speed = trace.simulated[trace.usable], float(np.abs(trace.inputs.speed[trace.usable]).max())
        largest = [max(float(np.quantile(side * force, 0.998)), 200.0) for side in self.sides]
        return [(*(share * f for f in largest), speed / max(largest)) for share in OPENS_AT]


class ReboundRelief(BlowOff):
    """A valve that opens in rebound."""

    form, edits, sides, needs = "rebound_relief", True, (-1.0,), "rebound forces at which the real valve opens"
    parameters = (REBOUND, OPENING)


class CompressionRelief(BlowOff):
    """A valve that opens in compression."""

    form, edits, sides, needs = "compression_relief", True, (1.0,), "compression forces at which the real valve opens"
    parameters = (COMPRESSION, OPENING)


class TwoSidedRelief(BlowOff):
    """One valve for each direction, each with its level."""

    form, edits, sides, needs = "relief", True, (-1.0, 1.0), "forces at which the real valves open"
    parameters = (REBOUND, COMPRESSION, OPENING)
