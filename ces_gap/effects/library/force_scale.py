"""Force scale: the gain of cell and amplifier, or of a lever between cell and damper, differs from the assumption."""

from __future__ import annotations

from collections.abc import Sequence

from ces_data.arrays import F
from ces_gap.effects.effect import CELL, Effect, magnitude
from ces_gap.trace import Trace, TraceInputs


class ForceScale(Effect):
    """g F. Strain-gauge cells keep their gain within 1 %; a wrong range, lever or unit causes some 10 %."""

    name, form, stage, needs = "force_scale", "gain", CELL, "forces well above the noise"
    summary = "the gain of the force is wrong"
    visible, mistaken_for = "in proportion to the force", ("current_scale", "temperature_fade")
    parameters = (magnitude("gain", 0.7, 1.3, (1.03,), "measured force over damper force", 1.0),)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return force * values[0]
