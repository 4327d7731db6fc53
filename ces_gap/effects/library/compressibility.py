"""Compressibility: oil, hoses and bubbles store volume, so that force builds up late, differently in each direction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ces_gap.effects.effect import FLUID, Effect, EffectParameter, TwinRun, magnitude
from ces_gap.grid import rms

MIN_OWN_M_N = 1e-9  # [m/N] compliance that every chamber has at least
MIN_LENGTH_SHARE = 0.1  # of a column's length at position zero
SQUEEZED = 0.5  # of the RMS force
COMPLIANCE = magnitude("compliance_m_N", 0.0, 1e-3, (1e-7,), "mean compliance added to the chambers")


class Compressibility(Effect):
    name, stage = "compressibility", FLUID
    needs = "motion fast enough to change the force within tens of milliseconds"
    summary = "oil, hoses and bubbles are elastic"
    visible, mistaken_for = "as force builds up, differently in each direction", ("mount_compliance", "position_delay")
    bench = ("continuous", "width_N")


class SofterOil(Compressibility):
    """Inside the damper: its chambers store more, each in proportion to what it stored before."""

    form, edits = "softer_oil", True
    parameters = (COMPLIANCE,)

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        own = [max(c, MIN_OWN_M_N) for c in (run.body.compression_m_N, run.body.rebound_m_N)]
        softer = 1.0 + values[0] / (0.5 * sum(own))
        return run.with_body(compression_m_N=softer * own[0], rebound_m_N=softer * own[1])


class OilColumn(Compressibility):
    """A column of oil in series with the damper, whose compliance c (1 + x / L) grows with its length.

    L is the length at position zero, of a monotube's rod side 0.1 to 0.3 m. A mount is as soft at any stroke.
    """

    form, edits, limit = "column", True, "mount_compliance"
    parameters = (COMPLIANCE, EffectParameter("column_m", 0.04, 0.4, (0.1,), "length of the column", "log"))

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        softness = values[0] * np.maximum(1.0 + run.position / values[1], MIN_LENGTH_SHARE)
        return run.behind_spring(lambda force: softness * force, float(softness.max()))


class AiryColumn(Compressibility):
    """Oil with air in series with the damper: c F (1 + air / (1 + |F| / N)), soft while the force is small.

    N is half of the damper's RMS force. A mount is as soft at any force.
    """

    form, edits, limit = "airy_column", True, "mount_compliance"
    parameters = (
        COMPLIANCE,
        EffectParameter("air", 0.1, 30.0, (1.0, 5.0), "compliance of the air over that of the oil, at rest", "log"),
    )

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        compliance, air = values
        half_N = SQUEEZED * rms(run.force()) + 1e-3
        return run.behind_spring(
            lambda force: compliance * force * (1.0 + air / (1.0 + np.abs(force) / half_N)), compliance * (1.0 + air)
        )
