"""Cavitation: a chamber that fills too slowly opens a void, which must close before force builds up again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from ces_gap.effects.effect import FLUID, Effect, EffectParameter, magnitude
from ces_gap.effects.network import TwinRun
from ces_gap.trace import Trace

STARVED_AT, LOW_FLOOR = (0.3, 0.08, 0.02), 0.2  # shares of area and of pressure at which searches begin


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


class LowerFloor(Cavitation):
    """Inside the damper: a lower pressure of the reservoir, from which chambers run empty, and air that comes out."""

    form, edits = "lower_floor", True
    parameters = (
        EffectParameter("floor_share", 0.01, 1.0, (0.5, 0.2), "reservoir's pressure over the twin's", "log"),
        magnitude("air", 0.0, 100.0, (0.0, 1.0), "compliance of air that comes out, over that of the oil"),
    )

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        return run.with_body(reservoir_N=values[0] * run.body.reservoir_N, air=run.body.air + values[1])
