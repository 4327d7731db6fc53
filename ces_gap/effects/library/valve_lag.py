"""Valve lag: coil, spool and pilot follow the logged current with a delay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import exp

import numpy as np
from numba import njit
from scipy.ndimage import shift

from ces_data.arrays import F
from ces_gap.effects.effect import VALVE, Effect, TwinRun, magnitude
from ces_gap.trace import Trace, TraceInputs

LONGEST_S = 0.3  # [s] a slower valve is defective
TIME_CONSTANT = magnitude("time_constant_s", 0.0, LONGEST_S, (0.01, 0.05), "time constant of the valve")


class ValveLag(Effect):
    name, stage, needs = "valve_lag", VALVE, "a changing current"
    summary = "the valve follows the current with a lag"
    visible, mistaken_for = "after changes of current", ("current_hysteresis",)
    bench = ("responses", "time_63_s")


class _Filter(ValveLag):
    reruns = True

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        return inputs.with_current(rise_fall_lag(inputs.current, values[0], values[-1], trace.step_s))


class FirstOrderLag(_Filter):
    """τ·di'/dt + i' = i.

    Source: a coil's R-L circuit, or a pilot chamber behind an orifice; Spencer et al., J. Eng. Mech. 123 (1997). CES
    (continuously controlled electronic suspension) and magneto-rheological valves take 2 to 50 ms, with cold oil more.
    """

    form = "first_order"
    parameters = (TIME_CONSTANT,)


class RiseFall(_Filter):
    """The same with one time constant while the acting current grows and another while it falls.

    A spool is returned by its spring, a driver's current decays slowly through a diode.
    """

    form = "rise_fall"
    parameters = (
        magnitude("rise_s", 0.0, LONGEST_S, (0.01, 0.05), "time constant upwards"),
        magnitude("fall_s", 0.0, LONGEST_S, (0.01, 0.05), "time constant downwards"),
    )


class DeadTime(_Filter):
    """A dead time before the lag: τ·di'/dt + i' = i(t - delay). Buses have 1 to 20 ms."""

    form = "delay_and_lag"
    parameters = (magnitude("delay_s", 0.0, 0.05, (0.003, 0.015), "dead time"), TIME_CONSTANT)

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        late = np.asarray(shift(inputs.current, values[0] * trace.rate_Hz, order=1, mode="nearest"), dtype=np.float64)
        return inputs.with_current(rise_fall_lag(late, values[1], values[1], trace.step_s))


@njit(cache=True, nogil=True, error_model="numpy")
def rise_fall_lag(u: F, rise_s: float, fall_s: float, step_s: float) -> F:
    """Return u (n,) behind a first-order lag with time constant `rise_s` upward and `fall_s` downward."""
    out = np.empty_like(u)
    z = u[0]
    out[0] = z
    for k in range(1, len(u)):
        z = _lag_step(z, u[k - 1], u[k], rise_s if u[k] > z else fall_s, step_s)
        out[k] = z
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _lag_step(z: float, before: float, now: float, time_s: float, step_s: float) -> float:
    """Return the lag's next state, its input linear from `before` to `now` (first-order hold)."""
    ratio = time_s / step_s
    if ratio < 1e-9:
        return now
    pole = exp(-1.0 / ratio)
    ramp = ratio * (1.0 - pole)
    return pole * z + (ramp - pole) * before + (1.0 - ramp) * now


class SlowerPath(ValveLag):
    """Inside the damper: longer time constants of the valve, upwards and downwards."""

    form, edits = "path", True
    parameters = RiseFall.parameters

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        valve = run.body.valve
        return run.with_body(valve=replace(valve, rise_s=valve.rise_s + values[0], fall_s=valve.fall_s + values[1]))
