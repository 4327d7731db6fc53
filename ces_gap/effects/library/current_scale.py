"""Current scale: the current in the coil differs from the logged one by a gain and an offset."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.effect import SENSOR, Effect, magnitude
from ces_gap.trace import Trace, TraceInputs

GAIN = magnitude("gain", 0.5, 1.5, (0.95, 1.05), "acting current over logged current", 1.0)
BEYOND = 0.5  # of the logged range, 0 included: margin for the current of the simulation


class CurrentScale(Effect):
    """i' = gain·i + offset, clipped to the logged range widened by half."""

    name, stage, reruns = "current_scale", SENSOR, True
    summary = "gain or offset of the measured current"
    visible, mistaken_for = "in proportion to the effect of the current", ("force_scale", "leakage")
    bench = ("ranges", "range_N")

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        gain, offset = (*values, 0.0)[:2]
        low, high = min(float(inputs.current.min()), 0.0), max(float(inputs.current.max()), 0.0)
        margin = BEYOND * (high - low)
        return inputs.with_current(np.clip(gain * inputs.current + offset, low - margin, high + margin))


class CurrentGain(CurrentScale):
    """A shunt or conversion is wrong by a few per cent, an amplifier range by up to half."""

    form, needs = "gain", "a current other than zero"
    parameters = (GAIN,)


class GainAndOffset(CurrentScale):
    """The zero has drifted, too, by up to some tenths of an ampere."""

    form, needs = "gain_offset", "a changing current"
    parameters = (
        GAIN,
        magnitude("offset_A", -3.0, 3.0, (-0.1, 0.0, 0.1), "acting current at zero logged current", usual=(-0.3, 0.3)),
    )
