"""Valve lag: coil, spool and pilot follow the logged current with a delay."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import shift

from ces_data.arrays import F
from ces_gap.effects.effect import VALVE, Effect, EffectParameter
from ces_gap.effects.effect_kernels import rise_fall_lag
from ces_gap.trace import Trace, TraceInputs

LONGEST_S = 0.3  # [s] a slower valve is defective
TIME_CONSTANT = EffectParameter(
    "time_constant_s", 0.0, LONGEST_S, (0.01, 0.05), "time constant of the valve", magnitude=True
)


class ValveLag(Effect):
    """What all forms share."""

    name, stage, reruns, needs = "valve_lag", VALVE, True, "a changing current"
    summary = "the valve follows the current with a lag"


class FirstOrderLag(ValveLag):
    """τ·di'/dt + i' = i, discretised exactly for a current that is linear between ticks.

    Source: R-L coil behind a voltage source, or a pilot chamber filled through an orifice; B. F. Spencer et al., J.
    Eng. Mech. 123 (1997), have this filter between driver and magneto-rheological damper. CES (continuously controlled
    electronic suspension) and magneto-rheological valves take 2 to 50 ms, with cold oil more.
    """

    form = "first_order"
    parameters = (TIME_CONSTANT,)

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        """Return the inputs with the acting current."""
        return inputs.with_current(rise_fall_lag(inputs.current, values[0], values[0], trace.step_s))


class RiseFall(ValveLag):
    """The same with one time constant while the acting current grows and another while it falls.

    Source: a spool pushed by the solenoid and returned by its spring, or a driver that decays slowly through a diode.
    """

    form = "rise_fall"
    parameters = (
        EffectParameter("rise_s", 0.0, LONGEST_S, (0.01, 0.05), "time constant upwards", magnitude=True),
        EffectParameter("fall_s", 0.0, LONGEST_S, (0.01, 0.05), "time constant downwards", magnitude=True),
    )

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        """Return the inputs with the acting current."""
        return inputs.with_current(rise_fall_lag(inputs.current, values[0], values[1], trace.step_s))


class DeadTime(ValveLag):
    """A dead time before the lag: τ·di'/dt + i' = i(t - delay).

    Source: bus cycles and the spool's travel through its overlap. Buses have 1 to 20 ms; 50 ms is a lost cycle or two.
    """

    form = "delay_and_lag"
    parameters = (EffectParameter("delay_s", 0.0, 0.05, (0.003, 0.015), "dead time", magnitude=True), TIME_CONSTANT)

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        """Return the inputs with the acting current."""
        late = np.asarray(shift(inputs.current, values[0] * trace.rate_Hz, order=1, mode="nearest"), dtype=np.float64)
        return inputs.with_current(rise_fall_lag(late, values[1], values[1], trace.step_s))


FORMS = (FirstOrderLag(), RiseFall(), DeadTime())
