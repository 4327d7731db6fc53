"""Errors of the simulation itself, in the form of effects: its force map (calibration) and its timing.

Reference recordings teach a correction of the simulation's error. Without them these errors compete with the effects of
the library. The map of stroke, speed and current is a discrepancy in the sense of Kennedy and O'Hagan (2001): it could
absorb a part of most effects. It is therefore one hypothesis among others, and it must explain more than an effect
(`prior_share`): a simulation whose own error is a third of an effect leaves a ninth of the gap's energy, which the map
absorbs and the effect does not. An effect that explains about as much is preferred (the small discrepancy of Plumlee
2017, and Gu and Wang 2018).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ces_data.arrays import F
from ces_gap.effects.effect import SIMULATION, Effect, EffectParameter, magnitude
from ces_gap.grid import apply_response
from ces_gap.limits import SearchLimits
from ces_gap.trace import Trace, TraceInputs

KNEE_M_S = 0.05  # [m/s] speed at which the force of a damper's bleed bends
MAX_GAIN = 3.0  # of the sharpening of a force that was smoothed: it also amplifies noise

Term = tuple[EffectParameter, Callable[[F, F, F], F]]  # weight, and what it weighs: of stroke, speed, current


def _term(name: str, limit: float, what: str, of: Callable[[F, F, F], F]) -> Term:
    return magnitude(name, -limit, limit, (0.0,), what), of


def _direction(speed: F) -> F:
    """Return the direction of motion (n,), rounded at low speed."""
    return np.asarray(speed / np.sqrt(KNEE_M_S**2 + speed * speed))


CURVE: tuple[Term, ...] = (
    _term("offset_N", 3000.0, "force added everywhere", lambda x, v, i: np.ones_like(v)),
    _term("per_speed_N_s_m", 2e4, "force over speed", lambda x, v, i: v),
    _term("per_square_N_s2_m2", 2e4, "force over signed speed squared", lambda x, v, i: v * np.abs(v)),
    _term("asymmetry_N_s2_m2", 2e4, "force over speed squared, the same in both directions", lambda x, v, i: v * v),
    _term(
        "direction_N", 3000.0, "force in the direction of motion, rounded below 0.05 m/s", lambda x, v, i: _direction(v)
    ),
)
STROKE: tuple[Term, ...] = (
    _term("per_stroke_N_m", 4e4, "force over stroke", lambda x, v, i: x),
    _term("per_stroke_square_N_m2", 1e6, "force over stroke squared", lambda x, v, i: x * x),
    _term("per_stroke_speed_N_s_m2", 4e5, "force over stroke times speed", lambda x, v, i: x * v),
)
CURRENT: tuple[Term, ...] = (
    _term("per_current_N_A", 3000.0, "force over current", lambda x, v, i: i),
    _term("per_current_square_N_A2", 3000.0, "force over current squared", lambda x, v, i: i * i),
    _term("current_speed_N_s_m_A", 2e4, "force over current times speed", lambda x, v, i: v * i),
    _term(
        "current_square_speed_N_s2_m2_A",
        2e4,
        "force over current times signed speed squared",
        lambda x, v, i: v * np.abs(v) * i,
    ),
    _term(
        "current_direction_N_A",
        3000.0,
        "force over current in the direction of motion",
        lambda x, v, i: _direction(v) * i,
    ),
    _term("current_stroke_N_m_A", 4e4, "force over current times stroke", lambda x, v, i: x * i),
)


class _Calibration(Effect):
    """A map of the simulation's inputs added to its force: the weighted sum of the terms."""

    name, stage, prior_share = "calibration", SIMULATION, SearchLimits.MAP
    summary = "the simulation's force map is off"
    terms: ClassVar[tuple[Term, ...]] = ()

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        at = inputs.position, inputs.speed, inputs.current
        return np.asarray(force + sum(value * of(*at) for value, (_, of) in zip(values, self.terms, strict=True)))


class SpeedCurve(_Calibration):
    """A curve of speed added to the simulated force."""

    form, needs = "speed_curve", "speeds at which the simulation is off"
    terms = CURVE
    parameters = tuple(weight for weight, _ in terms)


class ForceMap(_Calibration):
    """A map of stroke, speed and current added to the simulated force."""

    form, needs = "map", "strokes, speeds or currents at which the simulation is off"
    terms = (*CURVE, *STROKE)
    parameters = tuple(weight for weight, _ in terms)


class ForceMapOfCurrent(_Calibration):
    """The same, changing with the current."""

    form, needs = "map_of_current", "a changing current"
    terms = (*CURVE, *STROKE, *CURRENT)
    parameters = tuple(weight for weight, _ in terms)


class SampleTiming(Effect):
    """The simulated force behind exp(-i w skew - w² spread / 2): a shift and a smoothing that are counted in samples.

    A moving average over m samples has a spread of (m² - 1)/12 samples²; linear interpolation and a hold are alike. A
    negative spread sharpens a simulated force that had been smoothed.
    """

    name, form, stage, nuisance = "simulation_timing", "samples", SIMULATION, True
    summary = "the simulated force is a sample off, or smoothed"
    needs = "motion"
    parameters = (
        magnitude("skew_samples", -1.0, 1.0, (0.0,), "delay to be added to the simulated force"),
        magnitude("spread_samples2", -2.0, 2.0, (0.0,), "smoothing to be added to it"),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) with the timing corrected."""
        skew_s, spread_s2 = values[0] * trace.sample_s, values[1] * trace.sample_s**2

        def response(w: F) -> NDArray[np.complex128]:
            return np.asarray(np.minimum(np.exp(-0.5 * spread_s2 * w * w), MAX_GAIN) * np.exp(-1j * w * skew_s))

        return apply_response(force, trace.rate_Hz, response)


CALIBRATION_FORMS = (SpeedCurve(), ForceMap(), ForceMapOfCurrent())


def simulation_errors() -> tuple[Effect, ...]:
    """Return every form of every error of the simulation."""
    return (*CALIBRATION_FORMS, SampleTiming())
