"""Calibration: the simulation's force is off by a smooth static map of stroke, speed and current.

The map is a discrepancy in the sense of Kennedy and O'Hagan (2001): it could absorb a part of most effects. It is
therefore one hypothesis among others, and it must explain more than an effect (`prior_share`): a simulation whose own
error is a third of an effect leaves a ninth of the gap's energy, which the map absorbs and the effect does not. An
effect that explains about as much is preferred (the small discrepancy of Plumlee 2017, and Gu and Wang 2018).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from ces_gap.effects.effect import SIMULATION, Effect, EffectParameter
from ces_gap.trace import F, Trace, TraceInputs

MAP_SHARE = 0.15  # of the gap's energy
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
    needs = "speeds at which the simulation is off"
    parameters = (OFFSET, *CURVE)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the corrected force [N] (n,)."""
        return force + values[0] + _curve(inputs.speed, values[1:])


class ForceMap(Effect):
    """A map of stroke, speed and current added to the simulated force."""

    name, form, stage, prior_share = "calibration", "map", SIMULATION, MAP_SHARE
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


FORMS = (SpeedCurve(), ForceMap(), ForceMapOfCurrent())
