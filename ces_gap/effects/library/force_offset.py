"""Force offset: the zero of the cell, or a tare at another gas force, differs from that of the simulation."""

from __future__ import annotations

from collections.abc import Sequence

from ces_data.arrays import F
from ces_gap.effects.effect import CELL, Effect, magnitude
from ces_gap.trace import Trace, TraceInputs


class ForceOffset(Effect):
    """F + F0. Bridges keep their zero within some newtons; a tare at another gas force is wrong by hundreds."""

    name, form, stage, needs = "force_offset", "constant", CELL, "a tare that agrees with the simulation"
    summary = "the zero of the force is wrong"
    visible, mistaken_for = "equally everywhere", ("gas_spring",)
    bench = ("work", "mid_force_N")
    parameters = (
        magnitude(
            "offset_N", -1e5, 1e5, (20.0,), "measured force when the damper force is zero", usual=(-3000.0, 3000.0)
        ),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return force + values[0]
