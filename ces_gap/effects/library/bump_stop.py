"""Bump stop: near an end of the stroke a rubber or foam stop adds its force."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ces_gap.effects.effect import PARALLEL, Effect, EffectParameter
from ces_gap.trace import F, Trace, TraceInputs

ROUNDING_M = 0.00015  # [m] over this a stop comes into contact: lips and unevenness
FREE = 0.6  # share of the time that a stop is out of contact, at least
TOUCHES_AT = (0.93, 0.8, 0.6)  # of the way from mean to largest stroke: where searches begin
KINDS = ((1e5, 0.0), (1e4, 1e7))  # [N/m], [N/m2] where searches begin: linear, and foam

STIFFNESS = EffectParameter("stiffness_N_m", 0.0, 5e6, (1e5,), "stiffness of the stop at first touch", magnitude=True)
HARDENING = EffectParameter("hardening_N_m2", 0.0, 1e9, (0.0, 1e7), "force over depth squared, besides", magnitude=True)
COMPRESSION = EffectParameter(
    "compression_m", -0.5, 0.5, (0.02, 0.04), "position at which the compression stop touches"
)
REBOUND = EffectParameter("rebound_m", -0.5, 0.5, (-0.02, -0.04), "position at which the rebound stop touches")


class CompressionBumpStop(Effect):
    """A stop at the compression end: F + k d + h d2, d how deep it is pressed.

    Microcellular foam starts at 1e4 to 1e5 N/m and stiffens within millimetres to centimetres (Dixon, The Shock
    Absorber Handbook, 2nd ed. 2007, on bump stops); steel on steel is linear at 1e6 N/m and more.
    """

    name, form, stage, needs = "bump_stop", "compression", PARALLEL, "strokes that reach the compression stop"
    parameters = (STIFFNESS, HARDENING, COMPRESSION)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) of damper and stop."""
        stiffness, hardening, at = values
        return force + _stop(inputs.position - _contact_position_m(trace, at, 1.0), stiffness, hardening)

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        """Return contacts short of the largest stroke, for a linear stop and for foam."""
        return [(*kind, end) for end in _ends(trace, 1.0) for kind in KINDS]


class ReboundBumpStop(Effect):
    """A stop at the rebound end, pulling back: F - k d - h d2."""

    name, form, stage, needs = "bump_stop", "rebound", PARALLEL, "strokes that reach the rebound stop"
    parameters = (STIFFNESS, HARDENING, REBOUND)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) of damper and stop."""
        stiffness, hardening, at = values
        return force - _stop(_contact_position_m(trace, at, -1.0) - inputs.position, stiffness, hardening)

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        """Return contacts short of the largest stroke, for a linear stop and for foam."""
        return [(*kind, end) for end in _ends(trace, -1.0) for kind in KINDS]


class TwoSidedBumpStop(Effect):
    """Stops of one kind at both ends, each with its place."""

    name, form, stage, needs = "bump_stop", "both", PARALLEL, "strokes that reach both stops"
    parameters = (STIFFNESS, HARDENING, COMPRESSION, REBOUND)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) of damper and stops."""
        stiffness, hardening, compression, rebound = values
        pushes = _stop(inputs.position - _contact_position_m(trace, compression, 1.0), stiffness, hardening)
        return force + pushes - _stop(_contact_position_m(trace, rebound, -1.0) - inputs.position, stiffness, hardening)

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        """Return contacts short of the largest strokes, for linear stops and for foam."""
        ends = list(zip(_ends(trace, 1.0), _ends(trace, -1.0), strict=True))
        return [(*kind, *end) for end in ends for kind in KINDS]


def _stop(depth: F, stiffness: float, hardening: float) -> F:
    """Return the force [N] (n,) of a stop pressed `depth` [m] deep, negative where it is out of contact."""
    ratio = depth / ROUNDING_M
    pressed = ROUNDING_M * (np.maximum(ratio, 0.0) + np.log1p(np.exp(-np.abs(ratio))))
    return np.asarray(pressed * (stiffness + hardening * pressed))


def _contact_position_m(trace: Trace, at: float, sign: float) -> float:
    """Return where the stop touches [m], so far out that it is free for most of the recording: else it is a spring."""
    return sign * max(sign * at, float(np.quantile(sign * trace.inputs.position, FREE)))


def _ends(trace: Trace, sign: float) -> list[float]:
    stroke = sign * trace.inputs.position
    mean, most = float(np.mean(stroke)), float(np.max(stroke))
    return [float(np.clip(sign * (mean + share * (most - mean)), -0.5, 0.5)) for share in TOUCHES_AT]


FORMS = (CompressionBumpStop(), ReboundBumpStop(), TwoSidedBumpStop())
