"""Bump stop: near an end of the stroke a rubber or foam stop adds its force."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.effect import PARALLEL, Effect, EffectParameter
from ces_gap.trace import Trace, TraceInputs

ROUNDING_M = 0.00015  # [m] width over which a stop comes into contact: lips and unevenness
FREE = 0.6  # minimum share of the time without contact
TOUCHES_AT = (0.93, 0.8, 0.6)  # from mean to largest stroke: contacts at which searches begin
KINDS = ((1e5, 0.0), (1e4, 1e7))  # [N/m], [N/m2] at which searches begin: linear stop, foam

STIFFNESS = EffectParameter("stiffness_N_m", 0.0, 5e6, (1e5,), "stiffness of the stop at first contact", magnitude=True)
HARDENING = EffectParameter(
    "hardening_N_m2", 0.0, 1e9, (0.0, 1e7), "added force over deflection squared", magnitude=True
)
COMPRESSION = EffectParameter("compression_m", -0.5, 0.5, (0.02, 0.04), "position of contact with the compression stop")
REBOUND = EffectParameter("rebound_m", -0.5, 0.5, (-0.02, -0.04), "position of contact with the rebound stop")


class BumpStop(Effect):
    """What all forms share."""

    name, stage = "bump_stop", PARALLEL
    summary = "a stop engages near the end of the stroke"


class OneSidedBumpStop(BumpStop):
    """A stop at the end of the stroke in direction `sign`: F ± (k d + h d2), d its deflection.

    Microcellular foam starts at 1e4 to 1e5 N/m and stiffens within millimetres to centimetres (Dixon, The Shock
    Absorber Handbook, 2nd ed. 2007, on bump stops); steel on steel is linear at 1e6 N/m and more.
    """

    sign = 1.0

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) of damper and stop."""
        return force + _stop_force(trace, inputs, values[2], self.sign, values[0], values[1])

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        """Return contacts within the stroke, for a linear stop and for foam."""
        return [(*kind, end) for end in _ends(trace, self.sign) for kind in KINDS]


class CompressionBumpStop(OneSidedBumpStop):
    """A stop at the compression end: F + k d + h d2."""

    form, needs = "compression", "strokes that reach the compression stop"
    parameters = (STIFFNESS, HARDENING, COMPRESSION)


class ReboundBumpStop(OneSidedBumpStop):
    """A stop at the rebound end, which pulls: F - k d - h d2."""

    form, sign, needs = "rebound", -1.0, "strokes that reach the rebound stop"
    parameters = (STIFFNESS, HARDENING, REBOUND)


class TwoSidedBumpStop(BumpStop):
    """Equal stops at both ends, each with its position."""

    form, needs = "both", "strokes that reach both stops"
    parameters = (STIFFNESS, HARDENING, COMPRESSION, REBOUND)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) of damper and stops."""
        stiffness, hardening, compression, rebound = values
        force = force + _stop_force(trace, inputs, compression, 1.0, stiffness, hardening)
        return force + _stop_force(trace, inputs, rebound, -1.0, stiffness, hardening)

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        """Return contacts within the stroke, for linear stops and for foam."""
        ends = list(zip(_ends(trace, 1.0), _ends(trace, -1.0), strict=True))
        return [(*kind, *end) for end in ends for kind in KINDS]


def _stop_force(
    trace: Trace, inputs: TraceInputs, contact_m: float, sign: float, stiffness: float, hardening: float
) -> F:
    """Return the force [N] (n,) of a stop, which has no contact during at least `FREE` of the recording."""
    contact = max(sign * contact_m, float(np.quantile(sign * trace.inputs.position, FREE)))
    ratio = (sign * inputs.position - contact) / ROUNDING_M
    deflection = ROUNDING_M * (np.maximum(ratio, 0.0) + np.log1p(np.exp(-np.abs(ratio))))
    return np.asarray(sign * deflection * (stiffness + hardening * deflection))


def _ends(trace: Trace, sign: float) -> list[float]:
    stroke = sign * trace.inputs.position
    mean, most = float(np.mean(stroke)), float(np.max(stroke))
    return [float(np.clip(sign * (mean + share * (most - mean)), -0.5, 0.5)) for share in TOUCHES_AT]


FORMS = (CompressionBumpStop(), ReboundBumpStop(), TwoSidedBumpStop())
