"""Force offset: the zero of the cell, or a tare at another gas force, differs from that of the simulation."""

from __future__ import annotations

from collections.abc import Sequence

from ces_data.arrays import F
from ces_gap.effects.effect import CELL, Effect, EffectParameter
from ces_gap.trace import Trace, TraceInputs


class ForceOffset(Effect):
    """A constant added to the force: F + F0.

    Bridges keep their zero within some newtons; a tare at another gas force is wrong by hundreds.
    """

    name, form, stage, needs = "force_offset", "constant", CELL, "a tare that agrees with the simulation"
    summary = "the zero of the force is wrong"
    parameters = (
        EffectParameter(
            "offset_N", -3000.0, 3000.0, (20.0,), "measured force when the damper force is zero", magnitude=True
        ),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) as the cell measures it."""
        return force + values[0]


FORMS = (ForceOffset(),)
