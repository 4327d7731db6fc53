"""Cavitation: a chamber that fills too slowly opens a void, which must close before force builds up again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.effect import FLUID, Effect, EffectParameter, TwinRun, stiffness
from ces_gap.effects.library.backlash import change_by_joint
from ces_gap.trace import Trace, TraceInputs

STARVED_AT, LOW_FLOOR = (0.3, 0.08, 0.02), 0.2  # shares of area and of pressure at which searches begin
VOID_AT = (0.75, 0.4, 0.5, 0.62, 0.9)  # shares of a large simulated force at which searches of a void begin
LARGE = 99.5  # [%] of the simulated forces that lie below a large one
LONGEST_VOID_M = 1.0  # [m] longer than any stroke


class Cavitation(Effect):
    """A void that opens in rebound takes force in compression, one that opens in compression takes force in rebound."""

    name, stage, needs = "cavitation", FLUID, "fast strokes followed by reversals"
    summary = "a void forms in a fast stroke and must refill"
    visible, mistaken_for = "after fast strokes, on the way back", ("backlash", "compressibility")


class StarvedRefill(Cavitation):
    """Inside the damper: the compression chamber refills through a smaller area, so that a void forms and must close.

    `floor_share` is the pressure of the reservoir, from which the chamber runs empty, over that of the twin.
    """

    form, edits = "starved_refill", True
    edge: ClassVar[str] = "base"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("area_share", 1e-3, 1.0, STARVED_AT, "area of the refill over the twin's", "log"),
        EffectParameter("floor_share", 0.01, 5.0, (1.0,), "reservoir's pressure over the twin's", "log"),
    )

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        area, floor = values
        narrowed = run.with_flow(self.edge, lambda flow, drop: np.where(drop < 0.0, area * flow, flow))
        return narrowed.with_body(reservoir_N=floor * run.body.reservoir_N)

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        return [(area, floor) for area in STARVED_AT for floor in (1.0, LOW_FLOOR)]


class StarvedRebound(StarvedRefill):
    """The same for the rebound chamber."""

    form, edge = "starved_rebound", "external"


class VoidInCompression(Cavitation):
    """A void between rod and oil: compression opens it at the force `void_N`, and the way back closes it first.

    The force stays at `void_N` until the void is full again (Dixon 2007, on cavitation). Outside the twin, whose
    yielding springs would carry their force through a void.
    """

    form: ClassVar[str] = "void_in_compression"
    direction: ClassVar[float] = 1.0
    parameters = (stiffness("void_N", 10.0, 1e6, (1e3,), "force at which a chamber runs empty"),)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        ends = (0.0, LONGEST_VOID_M) if self.direction > 0.0 else (-LONGEST_VOID_M, 0.0)
        return force + change_by_joint(trace, inputs, force, ends, 0.0, self.direction * values[0])

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        simulated = self.direction * trace.simulated[trace.usable | ~trace.usable.any()]
        large = max(float(np.percentile(simulated, LARGE)), 100.0)
        return [(share * large,) for share in VOID_AT]


class VoidInRebound(VoidInCompression):
    """The same in the other direction."""

    form, direction = "void_in_rebound", -1.0
