"""Temperature fade: oil thins as it warms, by the work done in the damper, so that the force falls."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from ces_gap.effects.effect import FLUID, Effect, EffectParameter
from ces_gap.trace import F, Trace, TraceInputs

RETURN_S = 0.5  # [s] within which a leaked stroke is forgotten

PER_HEAT = EffectParameter(
    "fade_per_J",
    0.0,
    1e-3,
    (5e-6, 4e-5),
    "share of the force lost per joule: per kelvin, over heat capacity",
    magnitude=True,
)
COOLING = EffectParameter(
    "cooling_s", 5.0, 3000.0, (40.0,), "time constant of cooling: heat capacity over conductance", "log"
)
LEAKING = EffectParameter(
    "leak_m_sN_per_J", 0.0, 1e-7, (3e-9, 1e-8), "speed that leaks per newton, grown per joule", magnitude=True
)
LAMINAR = EffectParameter("laminar_m_s", 0.005, 5.0, (0.1,), "speed at which half of the force is viscous", "log")
PER_KELVIN = EffectParameter("fade_per_K", 0.0, 0.05, (0.003,), "share of the force lost per kelvin", magnitude=True)


class FadeByWork(Effect):
    """Heat that stays: F exp(-b E), E the work done since the recording began.

    Source: Lion and Loose, Vehicle System Dynamics 37 (2002), on dampers that heat themselves. 0.1 to 1 % of the force
    per kelvin over a heat capacity of 300 to 2000 J/K: 1e-6 to 3e-5 per joule; small dampers of thick oil have more.
    """

    name, form, stage, needs = "temperature_fade", "heated", FLUID, "hard work over some ten seconds or more"
    parameters = (PER_HEAT,)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) of the warmer damper."""
        return np.asarray(force * np.exp(-values[0] * _heat(trace, inputs, force)))


class FadeWithCooling(Effect):
    """Heat that leaves again: F exp(-b H), dH/dt = F v - H/tau.

    Dampers cool within 1 to 20 minutes by air, oil in its chamber against the tube within some ten seconds.
    """

    name, form, stage, needs = "temperature_fade", "cooled", FLUID, "hard work, then rest, over a minute or more"
    parameters = (PER_HEAT, COOLING)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) of the warmer damper."""
        return np.asarray(force * np.exp(-values[0] * _heat(trace, inputs, force, values[1])))


class Viscous(Effect):
    """Only the viscous share fades, that of the density stays: F (1 - (1 - exp(-b E)) / (1 + |v|/w)).

    Pressure drops a q + b q2 (Merritt, Hydraulic Control Systems, 1967): a falls with viscosity, b hardly.
    """

    name, form, stage = "temperature_fade", "viscous", FLUID
    needs = "hard work over some ten seconds or more, with slow and fast strokes"
    parameters = (PER_HEAT, LAMINAR)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) of the warmer damper."""
        lost = -np.expm1(-values[0] * _heat(trace, inputs, force))
        return np.asarray(force * (1.0 - lost / (1.0 + np.abs(inputs.speed) / values[1])))


class ThinnerOil(Effect):
    """Thin oil also slips through gaps: the plant moved by x - s, then F exp(-b E).

    s is the stroke leaked, ds/dt = l E F - s/(0.5 s): gaps pass laminar flow by pressure and fluidity, which
    delays the force's build-up; the slow return holds the stroke where it was measured. Source: Merritt 1967.
    """

    name, form, stage, reruns = "temperature_fade", "thinner_oil", FLUID, True
    needs = "hard work over some ten seconds or more, with reversals"
    parameters = (PER_HEAT, LEAKING)

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        """Return the inputs without the stroke that leaks."""
        leaking = values[1] * _heat(trace, inputs, force) * force
        kept = float(np.exp(-trace.step_s / RETURN_S))
        leaked = np.asarray(lfilter([trace.step_s], [1.0, -kept], leaking))
        return inputs.with_position(inputs.position - leaked, trace.rate_Hz)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) of the warmer damper."""
        return np.asarray(force * np.exp(-values[0] * _heat(trace, inputs, force)))

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        """Return a mixture of both, and one that hardly leaks."""
        return [(1e-5, 5e-9), (4e-5, 1e-9)]


class FadeByTemperature(Effect):
    """By the measured temperature: F exp(-b (T - T0)), T0 at the beginning; no effect where none was recorded."""

    name, form, stage, needs = "temperature_fade", "measured", FLUID, "a temperature channel"
    parameters = (PER_KELVIN,)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) of the warmer damper."""
        return np.asarray(force * np.exp(-values[0] * _warming(trace)))


def _heat(trace: Trace, inputs: TraceInputs, force: F, cooling_s: float = np.inf) -> F:
    """Return the heat [J] (n,) the damper holds: the work done on it, less what has left."""
    kept = float(np.exp(-trace.step_s / cooling_s))
    heat = lfilter([trace.step_s], [1.0, -kept], force * inputs.speed)
    return np.asarray(np.maximum(heat, 0.0))


def _warming(trace: Trace) -> F:
    """Return how much warmer [K] (n,) than at its beginning the recording's temperature channel is."""
    channel = trace.recording.channels.get("temperature")
    known = np.isfinite(channel.values) if channel is not None else np.zeros(0, bool)
    if channel is None or not known.any():
        return np.zeros_like(trace.time_s)
    seconds = (channel.stamps_ns - trace.recording.channel("position").stamps_ns[0]) * 1e-9
    temperature = np.interp(trace.time_s, seconds[known], channel.values[known])
    return np.asarray(temperature - temperature[0])


FORMS = (FadeByWork(), FadeWithCooling(), Viscous(), ThinnerOil(), FadeByTemperature())
