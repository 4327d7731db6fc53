"""Backlash: free play in a joint in series; after each force reversal the damper rests until the play is crossed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.effect import MOTION, Effect, EffectParameter
from ces_gap.effects.effect_kernels import gated_play, loose_force, tight_force
from ces_gap.effects.series_strain import soft_width, subtract_stroke
from ces_gap.grid import thin_out
from ces_gap.plant_map import remove_high_frequencies
from ces_gap.trace import Trace, TraceInputs

GAP = EffectParameter("gap_m", 0.0, 0.01, (5e-4, 2e-3), "total free play", magnitude=True)
SUBSTEP_S = 5e-4  # [s] of the integration: the joint separates and closes between ticks


class Backlash(Effect):
    """What all forms share."""

    name, stage, needs = "backlash", MOTION, "reversals"
    summary = "free play in the linkage"


class HeldPlay(Backlash):
    """Play z in [-gap/2, gap/2]: x' = x - z, crossed only once the force has reversed.

    The joint stays in contact while it transmits force (a brake unloads its elastic part first; in a damper, force and
    speed reverse together); then dz/dt = v and the damper rests. Source: play that separates at zero force (Nordin and
    Gutman, Automatica 38, 2002). Worn rod ends have tenths of a millimetre, linkages and brakes several.
    """

    form, reruns = "held", True
    parameters = (GAP,)

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        """Return the motion of the damper."""
        acting = force - trace.learn_map(trace.inputs, force).rest(inputs.current)
        pushed = 0.5 * (1.0 + np.tanh(acting / soft_width(trace, acting)))
        return subtract_stroke(inputs, gated_play(inputs.position, pushed, values[0]), trace.rate_Hz)


class PartedPlay(Backlash):
    """The same, but the cell reads a constant level while the joint is open: it transmits no force, the damper creeps.

    The free damper moves so that its force equals that level: f(v' - c·dF/dt) + memory = `parted_N`, f and c learnt
    from the simulation (a map of speed and current behind its own spring); it moves with the joint again once the gap
    is crossed. The effect is the resulting change of the map's force. The level is the zero of the transmitted force:
    0 N, or the gas force by which the recording was tared. Source as above.
    """

    form = "parted"
    parameters = (
        GAP,
        EffectParameter("parted_N", -500.0, 500.0, (-20.0,), "reading of the cell while the joint is open"),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) that the joint transmits."""
        plant, (gap, level) = trace.sprung_map, values
        substeps = int(np.ceil(trace.step_s / SUBSTEP_S - 1e-6))
        options = plant.map.kernel(), plant.compliance, trace.step_s, substeps
        motion = np.ascontiguousarray(inputs.speed), plant.map.level(inputs.current)
        tight = tight_force(*motion, *options)
        memory = remove_high_frequencies(force - tight[::substeps], trace.rate_Hz)
        return force + thin_out(loose_force(*motion, memory, tight, gap, level, *options) - tight, substeps)


FORMS = (HeldPlay(), PartedPlay())
