"""A damper in memory, and a few effects on it, for tests of what can be told apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from made_recordings import recording_of

from ces_data.arrays import F
from ces_gap.baseline.plant import DirectSimulator, Plant
from ces_gap.effects.effect import Effect, EffectParameter
from ces_gap.trace import Trace, TraceInputs, make_trace
from ces_identify.simulations.simulation import FunctionSimulation


def damper(time_s: F, position_m: F, current_A: F) -> F:
    """Force in proportion to the current, soft in speed."""
    speed = np.gradient(position_m, time_s)
    return np.asarray(2000.0 * current_A * np.tanh(speed / 0.15))


SIMULATION = FunctionSimulation("damper", damper)
PLANT = Plant(DirectSimulator(SIMULATION))


def trace_of(position: F, current: F, rate_Hz: float = 500.0, constants: bool = False) -> Trace:
    time = np.arange(len(position)) / rate_Hz
    signals = {"position": position, "force": damper(time, position, current)}
    if constants:
        recording = replace(recording_of(time, **signals), constants={"current": float(current[0])})
    else:
        recording = recording_of(time, **signals, current=current)
    return make_trace(recording, SIMULATION.force(recording))


def drive(current: str = "steps", seconds: float = 6.0, rate_Hz: float = 500.0) -> Trace:
    """Two sines, and a current that steps or stays."""
    time = np.arange(round(seconds * rate_Hz)) / rate_Hz
    position = 0.02 * np.sin(2 * np.pi * 1.1 * time) + 0.003 * np.sin(2 * np.pi * 6.3 * time)
    level = np.array([0.3, 0.7, 0.5, 0.6])[(time / 0.4).astype(int) % 4]
    return trace_of(position, level if current == "steps" else np.full_like(time, 0.5), rate_Hz)


class Scale(Effect):
    """More force everywhere."""

    name, form = "scale", "gain"
    parameters = (EffectParameter("gain_1", 0.5, 2.0, (1.1, 0.9), "gain", magnitude=True, neutral=1.0),)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return values[0] * force


class CurrentGain(Effect):
    """More current than was logged: a rerun."""

    name, form, reruns = "current_gain", "gain", True
    parameters = (EffectParameter("gain_1", 0.5, 2.0, (1.1, 0.9), "gain", magnitude=True, neutral=1.0),)

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        return inputs.with_current(values[0] * inputs.current)


class CurrentOffset(Effect):
    """A constant more current than was logged: a rerun."""

    name, form, reruns = "current_offset", "offset", True
    parameters = (EffectParameter("offset_A", -0.2, 0.2, (0.02, -0.02), "offset", magnitude=True),)

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        return inputs.with_current(inputs.current + values[0])


class Friction(Effect):
    """Coulomb friction."""

    name, form = "friction", "coulomb"
    parameters = (
        EffectParameter("coulomb_N", 0.0, 300.0, (20.0,), "friction while sliding", magnitude=True),
        EffectParameter("transition_m_s", 1e-3, 1.0, (0.02, 0.3), "speed at which it is reached", scale="log"),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return np.asarray(force + values[0] * np.tanh(inputs.speed / values[1]))


class Rubbing(Friction):
    """The same physics under another name and in other numbers."""

    name, form = "rubbing", "slope"
    parameters = (
        EffectParameter("slope_N_s_m", 0.0, 3e5, (500.0,), "slope at rest", magnitude=True),
        EffectParameter("transition_m_s", 1e-3, 1.0, (0.05,), "speed at which it is reached", scale="log"),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return np.asarray(force + values[0] * values[1] * np.tanh(inputs.speed / values[1]))


class Spring(Effect):
    """A spring in parallel."""

    name, form = "spring", "linear"
    parameters = (EffectParameter("stiffness_N_m", 0.0, 1e5, (500.0,), "stiffness", magnitude=True),)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return np.asarray(force + values[0] * inputs.position)
