"""Mount compliance: a rubber bushing or rod end in series takes part of the stroke, equally in both directions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.effect import MOTION, EffectParameter, stiffness
from ces_gap.effects.series import SeriesSpring, Strain, subtract_spring_stroke
from ces_gap.trace import Trace, TraceInputs

STIFFNESS = stiffness("stiffness_N_m", 5e4, 1e9, (3e5, 2e6, 1e7), "stiffness of the bushing")


class MountCompliance(SeriesSpring):
    name, stage = "mount_compliance", MOTION
    needs = "motion fast enough to change the force within tens of milliseconds"
    summary, moves = "elastic bushings", ("elasticity",)
    visible, mistaken_for = "as force builds up, equally in both directions", ("compressibility", "position_delay")


class LinearMount(MountCompliance):
    """A Kelvin-Voigt bushing: k·z + c·dz/dt = F, the damper moves x' = x - z; damping_s = c/k.

    Source: Dixon 2007, on bushings. Rubber has 1e5 to 1e7 N/m and relaxes within milliseconds; rod ends are stiffer.
    """

    form = "linear"
    parameters = (STIFFNESS, EffectParameter("damping_s", 0.0, 0.02, (0.001,), "relaxation time of the rubber, c/k"))

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        stiffness, damping_s = values
        return subtract_spring_stroke(
            trace, inputs, force, lambda f, _: (f / stiffness, np.full_like(f, 1.0 / stiffness)), damping_s
        )


class ProgressiveMount(MountCompliance):
    """A bushing that stiffens with load: z = (F_s/k)·asinh(F/F_s), stiffness k·√(1 + (F/F_s)²).

    F_s is `knee_N`: 100 N for a soft grommet, 5 kN for a full bush. asinh approximates rubber smoothly.
    """

    form = "progressive"
    parameters = (
        STIFFNESS,
        EffectParameter("knee_N", 50.0, 1e4, (200.0, 1000.0), "force from which the bushing stiffens", "log"),
    )

    def strain(self, force: F, width: float, values: Sequence[float]) -> Strain:
        stiffness, knee = values
        ratio = force / knee
        return knee / stiffness * np.arcsinh(ratio), 1.0 / (stiffness * np.sqrt(1.0 + ratio**2))
