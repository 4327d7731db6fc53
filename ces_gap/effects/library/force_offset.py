"""Force offset: the cell's zero, or a tare taken at another gas force, is not the simulation's."""

from __future__ import annotations

from collections.abc import Sequence

from ces_gap.effects.effect import CELL, Effect, EffectParameter
from ces_gap.trace import F, Trace, TraceInputs


class ForceOffset(Effect):
    """A constant added to the force: F + F0.

    Bridges keep their zero to some newtons; a tare under another gas force is off by hundreds.
    """

    name, form, stage, needs = "force_offset", "constant", CELL, "a tare that is the simulation's own"
    parameters = (
        EffectParameter(
            "offset_N", -3000.0, 3000.0, (20.0,), "measured force where the damper's is zero", magnitude=True
        ),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) as the cell shows it."""
        return force + values[0]


FORMS = (ForceOffset(),)
