"""Temperature fade: the work done in the damper warms the oil, which thins, so that the force falls."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from scipy.signal import lfilter

from ces_data.arrays import F
from ces_gap.effects.effect import FLUID, Effect, EffectParameter, TwinRun, magnitude
from ces_gap.trace import Trace, TraceInputs
from ces_observer.tick.pressures import WARMING_S

PER_HEAT = magnitude("fade_per_J", 0.0, 1e-3, (5e-6, 4e-5), "share of the force lost per joule")
COOLING = EffectParameter(
    "cooling_s", 5.0, 3000.0, (40.0,), "time constant of cooling: heat capacity over conductance", "log"
)
PER_KELVIN = magnitude("fade_per_K", 0.0, 0.05, (0.003,), "share of the force lost per kelvin")


class TemperatureFade(Effect):
    name, stage = "temperature_fade", FLUID
    summary = "warm oil damps less"
    visible, mistaken_for = "as heat accumulates", ("force_scale", "leakage")


class FadeByWork(TemperatureFade):
    """Heat is retained: F exp(-b E), E the work done since the start of the recording.

    Source: Lion and Loose, Vehicle System Dynamics 37 (2002). 0.1 to 1 % of the force per kelvin make 1e-6 to 3e-5 per
    joule; small dampers with thick oil have more.
    """

    form, needs = "heated", "hard work over some tens of seconds or more"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (PER_HEAT,)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return np.asarray(force * np.exp(-values[0] * _heat(trace, inputs, force, *values[1:])))


class FadeWithCooling(FadeByWork):
    """Heat is dissipated: F exp(-b H), dH/dt = F v - H/tau; within 1 to 20 minutes in air."""

    form, needs = "cooled", "hard work, then rest, over a minute or more"
    parameters = (PER_HEAT, COOLING)


class FadeByTemperature(TemperatureFade):
    """F exp(-b (T - T0)) by the measured temperature, T0 at the start."""

    form, needs = "measured", "a temperature channel"
    parameters = (PER_KELVIN,)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        channel = trace.recording.channels.get("temperature")
        known = np.isfinite(channel.values) if channel is not None else np.zeros(0, bool)
        if channel is None or not known.any():
            return force
        seconds = (channel.stamps_ns - trace.recording.channel("position").stamps_ns[0]) * 1e-9
        temperature = np.interp(trace.time_s, seconds[known], channel.values[known])
        return np.asarray(force * np.exp(-values[0] * (temperature - temperature[0])))


def _heat(trace: Trace, inputs: TraceInputs, force: F, cooling_s: float = np.inf) -> F:
    """Return the heat [J] (n,) in the damper: the work done on it minus the dissipated heat."""
    decay = float(np.exp(-trace.step_s / cooling_s))
    heat = lfilter([trace.step_s], [1.0, -decay], force * inputs.speed)
    return np.asarray(np.maximum(heat, 0.0))


class ThinnerInside(TemperatureFade):
    """Inside the damper: all flows grow with the work done, by e^(b E) while little heat is lost."""

    form, edits, needs = "thinner_inside", True, "hard work over some tens of seconds or more"
    parameters = (magnitude("growth_per_J", 0.0, 1e-2, (5e-6, 5e-5), "growth of the flows per joule"),)

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        return run.with_body(fade_1_W=run.body.fade_1_W + WARMING_S * values[0])
