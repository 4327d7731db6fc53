"""Inertia: moving mass between force cell and piston, such as the eye, an adapter or the flange of the cell."""

from __future__ import annotations

from collections.abc import Sequence

from ces_data.arrays import F
from ces_gap.effects.effect import PARALLEL, Effect, magnitude
from ces_gap.trace import Trace, TraceInputs

MASS = magnitude("mass_kg", 0.0, 2000.0, (0.5,), "moving mass between cell and piston", usual=(0.0, 20.0))


class Inertia(Effect):
    name, stage = "inertia", PARALLEL
    summary = "mass between sensor and piston"
    visible, mistaken_for = "at high frequency", ("position_delay",)


class Mass(Inertia):
    """F + m a. Eyes and flanges have 0.2 to 5 kg, a truck's damper up to 20 kg, the slide of an axis 100 kg."""

    form = "mass"
    needs = "strokes at several hertz (the force grows with the square of frequency)"
    parameters = (MASS,)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return force + values[0] * trace.acceleration
