"""Position delay: the position's stamps are early or late against the force's (sensor skew, filters, wrong stamps)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import shift

from ces_gap.effects.effect import SENSOR, Effect, EffectParameter
from ces_gap.effects.series_strain import subtract_stroke
from ces_gap.trace import F, Trace, TraceInputs


class Skew(Effect):
    """The damper moves as x'(t) = x(t - delay), by cubic splines: a positive delay means the position is logged early.

    The current is not moved. Source: a plain shift of time. Sensor buses, filters and log stamps make up to some
    10 ms; a late position (a filter before the logger) is a negative delay.
    """

    name, form, stage, reruns, needs = "position_delay", "shift", SENSOR, True, "motion"
    parameters = (
        EffectParameter(
            "delay_s", -0.02, 0.03, (0.003, -0.003), "by how much the force follows the position", magnitude=True
        ),
    )

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        """Return the motion at the time of the force."""
        position = shift(inputs.position, values[0] * trace.rate_Hz, order=3, mode="nearest")
        return subtract_stroke(inputs, inputs.position - np.asarray(position, dtype=np.float64), trace.rate_Hz)


FORMS = (Skew(),)
