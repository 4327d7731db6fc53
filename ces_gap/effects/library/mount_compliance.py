"""Mount compliance: a rubber bushing or rod end in series takes part of the stroke, equally in both directions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.effect import MOTION, Effect, EffectParameter
from ces_gap.effects.series_strain import Strain, subtract_spring_stroke
from ces_gap.trace import Trace, TraceInputs

STIFFNESS = EffectParameter(
    "stiffness_N_m", 5e4, 1e9, (3e5, 2e6, 1e7), "stiffness of the bushing", "inverse", True, float("inf")
)


class MountCompliance(Effect):
    """What all forms share."""

    name, stage, reruns = "mount_compliance", MOTION, True
    summary = "elastic bushings"


class LinearMount(MountCompliance):
    """A Kelvin-Voigt bushing: k·z + c·dz/dt = F, the damper moves x' = x - z; damping_s = c/k.

    Source: Dixon, The Shock Absorber Handbook (2nd ed. 2007), on mounting bushes; Kelvin-Voigt element. Rubber bushes
    of dampers have 1e5 to 1e7 N/m and relax within milliseconds; steel rod ends are stiffer.
    """

    form = "linear"
    needs = "motion fast enough to change the force within tens of milliseconds"
    parameters = (STIFFNESS, EffectParameter("damping_s", 0.0, 0.02, (0.001,), "relaxation time of the rubber, c/k"))

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        """Return the motion of the damper."""
        stiffness, damping_s = values

        def law(acting: F, width: float) -> Strain:
            return Strain(acting / stiffness, np.full_like(acting, 1.0 / stiffness))

        return subtract_spring_stroke(trace, inputs, force, law, damping_s)


class ProgressiveMount(MountCompliance):
    """A bushing that stiffens with load: z = (F_s/k)·asinh(F/F_s), stiffness k·√(1 + (F/F_s)²).

    Source: the progressive curve of rubber in compression (Dixon 2007); asinh approximates it smoothly. `knee_N`
    F_s is the force at which the stiffness has grown by 41 %: 100 N for a soft grommet, 5 kN for a full bush.
    """

    form = "progressive"
    needs = LinearMount.needs
    parameters = (
        STIFFNESS,
        EffectParameter("knee_N", 50.0, 1e4, (200.0, 1000.0), "force from which the bushing stiffens", "log"),
    )

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        """Return the motion of the damper."""
        stiffness, knee = values

        def law(acting: F, width: float) -> Strain:
            ratio = acting / knee
            return Strain(knee / stiffness * np.arcsinh(ratio), 1.0 / (stiffness * np.sqrt(1.0 + ratio**2)))

        return subtract_spring_stroke(trace, inputs, force, law)


FORMS = (LinearMount(), ProgressiveMount())
