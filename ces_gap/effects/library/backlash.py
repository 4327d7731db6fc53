"""Backlash: free play in a joint in series; after each reversal of the force the damper stands until it is crossed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import firwin

from ces_gap.effects.effect import MOTION, Effect, EffectParameter
from ces_gap.effects.effect_kernels import gated_play, loose_force, tight_force
from ces_gap.effects.series_strain import soft_width, subtract_stroke
from ces_gap.plant_map.own_spring import remove_high_frequencies
from ces_gap.trace import F, Trace, TraceInputs

GAP = EffectParameter("gap_m", 0.0, 0.01, (5e-4, 2e-3), "free play from stop to stop", magnitude=True)
SUBSTEP_S = 5e-4  # [s] of the integration: the moments of parting and contact fall between ticks


class HeldPlay(Effect):
    """Play z in [-gap/2, gap/2]: x' = x - z, crossed only once the force has come down to zero and turned over.

    The joint stays in contact while its force lasts (a brake unloads its elastic part first; in a damper, force and
    speed turn together), then dz/dt = v and the damper stands. Source: play whose contact is lost at no force (Nordin
    and Gutman, Automatica 38, 2002). Worn rod ends have tenths of a millimetre, linkages and brakes several.
    """

    name, form, stage, reruns, needs = "backlash", "held", MOTION, True, "reversals"
    parameters = (GAP,)

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        """Return the damper's own motion."""
        acting = force - trace.learn_map(trace.inputs, force).rest(inputs.current)
        pushed = 0.5 * (1.0 + np.tanh(acting / soft_width(trace, acting)))
        return subtract_stroke(inputs, gated_play(inputs.position, pushed, values[0]), trace.rate_Hz)


class PartedPlay(Effect):
    """The same, and the cell reads a constant level while the joint is parted: no force passes, the damper creeps.

    A damper that nothing holds moves so that its own force is that level: f(v' - c·dF/dt) + memory = `parted_N`, f and
    c learnt from the simulation (a map of speed and current behind its own spring); it moves with the joint again once
    the gap is crossed. The effect is the difference this makes to the map's force. The level is the zero of the force
    that passes: 0 N, or what the recording was tared by (the force of gas). Source as above.
    """

    name, form, stage, reruns, needs = "backlash", "parted", MOTION, False, "reversals"
    parameters = (GAP, EffectParameter("parted_N", -500.0, 500.0, (-20.0,), "what the cell reads while nothing passes"))

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] that passes the joint."""
        plant, (gap, level) = trace.sprung_map, values
        substeps = int(np.ceil(trace.step_s / SUBSTEP_S - 1e-6))
        how = plant.map.kernel(), plant.compliance, trace.step_s, substeps
        given = np.ascontiguousarray(inputs.speed), plant.map.level(inputs.current)
        tight = tight_force(*given, *how)
        memory = remove_high_frequencies(force - tight[::substeps], trace.rate_Hz)
        return force + _decimate(loose_force(*given, memory, tight, gap, level, *how) - tight, substeps)


def _decimate(values: F, factor: int) -> F:
    """Return every `factor`-th value behind the low-pass that measured forces have passed on their way to the grid."""
    taps = firwin(8 * factor + 1, 0.8 / factor) if factor > 1 else np.ones(1)
    return np.asarray(np.convolve(np.pad(values, len(taps) // 2, mode="edge"), taps, mode="valid")[::factor])


FORMS = (HeldPlay(), PartedPlay())
