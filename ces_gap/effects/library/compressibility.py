"""Compressibility: oil, hoses and bubbles store volume, so that force builds up late, differently in each direction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from ces_gap.effects.effect import FLUID, Effect, EffectParameter, magnitude
from ces_gap.effects.network import TwinRun

MIN_OWN_M_N = 1e-9  # [m/N] compliance that every chamber has at least


class Compressibility(Effect):
    name, stage = "compressibility", FLUID
    needs = "motion fast enough to change the force within tens of milliseconds"
    summary = "oil, hoses and bubbles are elastic"
    visible, mistaken_for = "as force builds up, differently in each direction", ("mount_compliance", "position_delay")


class SofterOil(Compressibility):
    """Inside the damper: its chambers store more, each in proportion to what it stored before."""

    form, edits = "softer_oil", True
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        magnitude("compliance_m_N", 0.0, 1e-3, (1e-7,), "mean compliance added to both chambers"),
    )

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        own = [max(c, MIN_OWN_M_N) for c in (run.body.compression_m_N, run.body.rebound_m_N)]
        softer = 1.0 + values[0] / (0.5 * sum(own))
        return run.with_body(compression_m_N=softer * own[0], rebound_m_N=softer * own[1])


class SofterChambers(Compressibility):
    """The same, each chamber by its own number."""

    form, edits = "softer_chambers", True
    parameters = (
        magnitude("compression_m_N", 0.0, 1e-3, (1e-7,), "compliance added to the compression chamber"),
        magnitude("rebound_m_N", 0.0, 1e-3, (1e-7,), "compliance added to the rebound chamber"),
    )

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        body = run.body
        return run.with_body(compression_m_N=body.compression_m_N + values[0], rebound_m_N=body.rebound_m_N + values[1])


class MoreAir(SofterOil):
    """The same, and more air in the oil, which is soft near the pressure of the reservoir."""

    form = "more_air"
    parameters = (
        *SofterOil.parameters,
        magnitude("air", 0.0, 300.0, (0.5, 3.0), "compliance of the air over that of the oil, at rest"),
    )

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        return super().edit(run, values).with_body(air=run.body.air + values[1])
