"""Inertia: moving mass between force cell and piston, such as the eye, an adapter or the flange of the cell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ces_data.arrays import F
from ces_gap.effects.effect import PARALLEL, Effect, EffectParameter, apply_response, magnitude
from ces_gap.trace import Trace, TraceInputs

DAMPING = 0.05  # damping ratio of the mass on the cell: bolted steel has 0.01 to 0.1
RESONANCES_HZ = (45.0, 60.0, 80.0, 105.0, 140.0, 200.0)  # at which searches begin
MASS_KG = 2.0  # [kg] at which they begin

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


class MassOnCell(Inertia):
    """A mass on an elastic cell: F + m a behind 1 / (1 + 2 z s/w + s²/w²), w² = k/m.

    Its deflection is left out (see mount_compliance). Cells and fixtures have 1e6 to 1e8 N/m.
    """

    form = "mass_on_cell"
    needs = "strokes or force edges that excite the cell's resonance"
    parameters = (MASS, EffectParameter("cell_N_m", 5e4, 1e9, (3e6,), "stiffness of the cell and its fixture", "log"))

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        mass, stiffness = values
        if mass <= 0.0:
            return force

        def response(frequency: F) -> NDArray[np.complex128]:
            ratio = np.sqrt(mass / stiffness) * frequency
            return np.asarray(1.0 / (1.0 - ratio**2 + 2j * DAMPING * ratio))

        return apply_response(force + mass * trace.acceleration, trace.rate_Hz, response)

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        return [(MASS_KG, MASS_KG * (2.0 * np.pi * f) ** 2) for f in RESONANCES_HZ]
