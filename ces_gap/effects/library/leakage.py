"""Leakage: flow through a worn seal, valve seat or bypass reduces the flow through the valve."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.effect import FLUID, Effect, TwinRun, magnitude

HOLE_NODES = 12  # of the curve of a hole, in each direction


class Leakage(Effect):
    name, stage, needs = "leakage", FLUID, "motion in the direction that leaks"
    summary = "oil bypasses the valves"
    visible, mistaken_for = "at low speed, under high pressure", ("current_scale", "temperature_fade")


class PastPiston(Leakage):
    """Inside the damper: a laminar gap between the chambers, which passes κ times their pressure difference."""

    form, edits = "past_piston", True
    edge: ClassVar[str] = "piston"
    parameters = (magnitude("leak_m_sN", 0.0, 1e-2, (1e-5,), "leaking speed per newton of pressure on the rod side"),)

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        return run.with_flow(self.edge, lambda flow, drop: flow + values[0] * drop)


class HeldOpen(Leakage):
    """Inside the damper: a hole in the piston, or its valve held open by dirt: κ·√|Δp|, κ by direction."""

    form, edits = "held_open", True
    parameters = (
        magnitude("rebound_m_s_rtN", 0.0, 0.1, (5e-4,), "leaking speed per √newton, rebound"),
        magnitude("compression_m_s_rtN", 0.0, 0.1, (5e-4,), "the same in compression"),
    )

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        laminar, most = run.body.laminar_N, run.body.most_N
        drops = np.geomspace(0.1 * laminar, min(most, 1e4 * laminar), HOLE_NODES)

        def leak(flow: F, drop: F) -> F:
            return np.asarray(flow + np.where(drop < 0.0, *values) * drop / np.sqrt(np.abs(drop) + laminar))

        return run.with_flow("piston", leak, [*-drops, *drops])


class PastBase(PastPiston):
    """The same from the compression chamber to the reservoir."""

    form, edge = "past_base", "base"


class PastAll(Leakage):
    """A dashpot in series with all else that the damper holds: its stroke creeps by κ·F."""

    form, edits = "past_all", True
    parameters = (magnitude("leak_m_sN", 0.0, 1e-2, (1e-5,), "creeping speed per newton"),)

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        return run.with_body(creep_m_Ns=run.body.creep_m_Ns + values[0])
