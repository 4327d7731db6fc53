"""Errors of the simulation itself, in the form of effects: its force map (calibration) and its timing.

Reference recordings teach a correction of the simulation's error. Without them these errors compete with the effects of
the library. The map of stroke, speed and current is a discrepancy in the sense of Kennedy and O'Hagan (2001): it could
absorb a part of most effects. It is therefore one hypothesis among others, and it must explain more than an effect
(`prior_share`): a simulation whose own error is a third of an effect leaves a ninth of the gap's energy, which the map
absorbs and the effect does not. An effect that explains about as much is preferred (the small discrepancy of Plumlee
2017, and Gu and Wang 2018).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ces_data.arrays import F
from ces_gap.effects.effect import SIMULATION, Effect, EffectParameter, apply_response
from ces_gap.trace import Trace, TraceInputs

MAP_SHARE = 0.15  # of the gap's energy
CALIBRATION_SUMMARY = "the simulation's force map is off"
KNEE_M_S = 0.05  # [m/s] speed at which the force of a damper's bleed bends


def _weight(name: str, limit: float, what: str) -> EffectParameter:
    return EffectParameter(name, -limit, limit, (0.0,), what, magnitude=True)


OFFSET = _weight("offset_N", 3000.0, "force added everywhere")
CURVE = (
    _weight("per_speed_N_s_m", 2e4, "force over speed"),
    _weight("per_square_N_s2_m2", 2e4, "force over signed speed squared"),
    _weight("asymmetry_N_s2_m2", 2e4, "force over speed squared, the same in both directions"),
    _weight("direction_N", 3000.0, "force in the direction of motion, rounded below 0.05 m/s"),
)
STROKE = (
    _weight("per_stroke_N_m", 4e4, "force over stroke"),
    _weight("per_stroke_square_N_m2", 1e6, "force over stroke squared"),
    _weight("per_stroke_speed_N_s_m2", 4e5, "force over stroke times speed"),
)
CURRENT = (
    _weight("per_current_N_A", 3000.0, "force over current"),
    _weight("per_current_square_N_A2", 3000.0, "force over current squared"),
    _weight("current_speed_N_s_m_A", 2e4, "force over current times speed"),
    _weight("current_square_speed_N_s2_m2_A", 2e4, "force over current times signed speed squared"),
    _weight("current_direction_N_A", 3000.0, "force over current in the direction of motion"),
    _weight("current_stroke_N_m_A", 4e4, "force over current times stroke"),
)


class SpeedCurve(Effect):
    """A curve of speed added to the simulated force."""

    name, form, stage, prior_share = "calibration", "speed_curve", SIMULATION, MAP_SHARE
    summary = CALIBRATION_SUMMARY
    needs = "speeds at which the simulation is off"
    parameters = (OFFSET, *CURVE)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the corrected force [N] (n,)."""
        return force + values[0] + _curve(inputs.speed, values[1:])


class ForceMap(Effect):
    """A map of stroke, speed and current added to the simulated force."""

    name, form, stage, prior_share = "calibration", "map", SIMULATION, MAP_SHARE
    summary = CALIBRATION_SUMMARY
    needs = "strokes, speeds or currents at which the simulation is off"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (OFFSET, *CURVE, *STROKE)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the corrected force [N] (n,)."""
        x, v, (k, k2, kv) = inputs.position, inputs.speed, values[5:8]
        return force + values[0] + _curve(v, values[1:5]) + k * x + k2 * x * x + kv * x * v


class ForceMapOfCurrent(ForceMap):
    """The same, changing with the current."""

    form, needs = "map_of_current", "a changing current"
    parameters = (OFFSET, *CURVE, *STROKE, *CURRENT)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the corrected force [N] (n,)."""
        x, v, i, (d, d2, dv, dq, ds, dx) = inputs.position, inputs.speed, inputs.current, values[8:]
        changing = d + d2 * i + dv * v + dq * v * np.abs(v) + ds * _direction(v) + dx * x
        return super().respond(trace, inputs, force, values[:8]) + changing * i


def _curve(speed: F, values: Sequence[float]) -> F:
    per_speed, per_square, asymmetry, direction = values
    curve = per_speed * speed + (per_square * np.abs(speed) + asymmetry * speed) * speed
    return np.asarray(curve + direction * _direction(speed))


def _direction(speed: F) -> F:
    """Return the direction of motion (n,), rounded at low speed."""
    return np.asarray(speed / np.sqrt(KNEE_M_S**2 + speed * speed))


CALIBRATION_FORMS = (SpeedCurve(), ForceMap(), ForceMapOfCurrent())


MAX_GAIN = 3.0  # of the sharpening of a force that was smoothed: it also amplifies noise


class SampleTiming(Effect):
    """The simulated force behind exp(-i w skew - w² spread / 2): a shift and a smoothing that are counted in samples.

    A moving average over m samples has a spread of (m² - 1)/12 samples²; linear interpolation and a hold are alike. A
    negative spread sharpens a simulated force that had been smoothed.
    """

    name, form, stage, nuisance = "simulation_timing", "samples", SIMULATION, True
    summary = "the simulated force is a sample off, or smoothed"
    needs = "motion"
    parameters = (
        EffectParameter("skew_samples", -1.0, 1.0, (0.0,), "delay to be added to the simulated force", magnitude=True),
        EffectParameter("spread_samples2", -2.0, 2.0, (0.0,), "smoothing to be added to it", magnitude=True),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) with the timing corrected."""
        skew_s, spread_s2 = values[0] * trace.sample_s, values[1] * trace.sample_s**2

        def response(w: F) -> NDArray[np.complex128]:
            return np.asarray(np.minimum(np.exp(-0.5 * spread_s2 * w * w), MAX_GAIN) * np.exp(-1j * w * skew_s))

        return apply_response(force, trace.rate_Hz, response)


TIMING_FORMS = (SampleTiming(),)


def simulation_errors() -> tuple[Effect, ...]:
    """Return every form of every error of the simulation."""
    return (*CALIBRATION_FORMS, *TIMING_FORMS)
