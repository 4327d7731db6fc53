"""Current scale: the current in the coil differs from the logged one by a gain and an offset."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.effect import SENSOR, Effect, EffectParameter
from ces_gap.trace import Trace, TraceInputs

GAIN = EffectParameter("gain", 0.5, 1.5, (0.95, 1.05), "acting current over logged current", "linear", True, 1.0)
BEYOND = 0.5  # of the logged range: margin for the current of the simulation


def scale_current(inputs: TraceInputs, gain: float, offset: float) -> TraceInputs:
    """Return the inputs with gain·i + offset, clipped to the logged range (0 included) widened by `BEYOND`."""
    low, high = min(float(inputs.current.min()), 0.0), max(float(inputs.current.max()), 0.0)
    margin = BEYOND * (high - low)
    acting = gain * inputs.current + offset
    return inputs.with_current(np.clip(acting, low - margin, high + margin))


class CurrentScale(Effect):
    """What all forms share."""

    name, stage, reruns = "current_scale", SENSOR, True
    summary = "gain or offset of the measured current"


class CurrentGain(CurrentScale):
    """i' = gain·i: a shunt or conversion wrong by a few per cent, up to a wrong amplifier range (50 %).

    Source: a plain calibration error.
    """

    form, needs = "gain", "a current other than zero"
    parameters = (GAIN,)

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        """Return the inputs with the acting current."""
        return scale_current(inputs, values[0], 0.0)


class GainAndOffset(CurrentScale):
    """i' = gain·i + offset: as above, with a zero that has drifted by up to some tenths of an ampere.

    Source: a plain calibration error.
    """

    form, needs = "gain_offset", "a changing current"
    parameters = (
        GAIN,
        EffectParameter("offset_A", -0.3, 0.3, (0.0, 0.03), "acting current at zero logged current", magnitude=True),
    )

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        """Return the inputs with the acting current."""
        return scale_current(inputs, values[0], values[1])


FORMS = (CurrentGain(), GainAndOffset())
