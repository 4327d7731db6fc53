"""Bump stop: near an end of the stroke a rubber or foam stop adds its force."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.effect import PARALLEL, Effect, EffectParameter, magnitude
from ces_gap.trace import Trace, TraceInputs

ROUNDING_M = 0.00015  # [m] width over which a stop comes into contact: lips and unevenness
FREE = 0.6  # minimum share of the time without contact
TOUCHES_AT = (0.93, 0.8, 0.6)  # from mean to largest stroke: contacts at which searches begin
KINDS = ((1e5, 0.0), (1e4, 1e7))  # [N/m], [N/m2] at which searches begin: linear stop, foam

STIFFNESS = magnitude("stiffness_N_m", 0.0, 5e8, (1e5,), "stiffness of the stop at first contact", usual=(0.0, 5e6))
HARDENING = magnitude("hardening_N_m2", 0.0, 1e9, (0.0, 1e7), "added force over deflection squared")
END_M = 10.0  # [m] farthest contact from the zero of the position
COMPRESSION = EffectParameter(
    "compression_m", -END_M, END_M, (0.02, 0.04), "position of contact with the compression stop", usual=(-0.5, 0.5)
)
REBOUND = EffectParameter(
    "rebound_m", -END_M, END_M, (-0.02, -0.04), "position of contact with the rebound stop", usual=(-0.5, 0.5)
)


class BumpStop(Effect):
    """F ± (k d + h d²) at an end of the stroke, d the deflection; out of contact for most of the recording.

    Foam starts at 1e4 to 1e5 N/m and stiffens within millimetres to centimetres (Dixon 2007); steel on steel is linear
    at 1e6 N/m and more.
    """

    name, stage = "bump_stop", PARALLEL
    summary = "a stop engages near the end of the stroke"
    visible, mistaken_for = "only at the ends of the stroke", ("gas_spring",)
    ends: ClassVar[tuple[float, ...]] = ()

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        stiffness, hardening, *contacts = values
        for end, contact_m in zip(self.ends, contacts, strict=True):
            contact = max(end * contact_m, float(np.quantile(end * trace.inputs.position, FREE)))
            deflection = ROUNDING_M * np.logaddexp(0.0, (end * inputs.position - contact) / ROUNDING_M)
            force = force + end * deflection * (stiffness + hardening * deflection)
        return force

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        """Return contacts within the stroke, for linear stops and for foam."""
        position = trace.inputs.position
        mean, reach = float(np.mean(position)), [float(np.max(end * position)) for end in self.ends]
        out: list[tuple[float, ...]] = []
        for share in TOUCHES_AT:
            contacts = [end * (end * mean + share * (m - end * mean)) for end, m in zip(self.ends, reach, strict=True)]
            out += [(*kind, *np.clip(contacts, -END_M, END_M).tolist()) for kind in KINDS]
        return out


class CompressionBumpStop(BumpStop):
    """A stop at the compression end."""

    form, ends, needs = "compression", (1.0,), "strokes that reach the compression stop"
    parameters = (STIFFNESS, HARDENING, COMPRESSION)


class ReboundBumpStop(BumpStop):
    """A stop at the rebound end, which pulls."""

    form, ends, needs = "rebound", (-1.0,), "strokes that reach the rebound stop"
    parameters = (STIFFNESS, HARDENING, REBOUND)


class TwoSidedBumpStop(BumpStop):
    """Equal stops at both ends, each with its position."""

    form, ends, needs = "both", (1.0, -1.0), "strokes that reach both stops"
    parameters = (STIFFNESS, HARDENING, COMPRESSION, REBOUND)
