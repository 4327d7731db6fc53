"""Position delay: the position is logged early or late relative to the force (sensor skew, filters, wrong stamps)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import shift

from ces_data.arrays import F
from ces_gap.effects.effect import SENSOR, Effect, magnitude
from ces_gap.trace import Trace, TraceInputs


class Skew(Effect):
    """x'(t) = x(t - delay), by cubic splines; positive: the position is logged early. The current is not shifted.

    Buses, filters and log stamps cause up to some 10 ms.
    """

    name, form, stage, reruns, needs = "position_delay", "shift", SENSOR, True, "motion"
    summary = "position and force are not synchronous"
    visible, mistaken_for = "wherever the force changes with motion", ("inertia", "compressibility")
    parameters = (magnitude("delay_s", -0.02, 0.03, (0.003, -0.003), "delay of the force relative to the position"),)

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        position = shift(inputs.position, values[0] * trace.rate_Hz, order=3, mode="nearest")
        return inputs.with_position(np.asarray(position, dtype=np.float64), trace.rate_Hz)
