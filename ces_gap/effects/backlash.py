"""Backlash: free play in a joint in series; after each reversal of the force the damper stands until it is crossed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_gap.effect import MOTION, Effect, Parameter
from ces_gap.effect_kernels import gated_play
from ces_gap.series_strain import less, soft_width
from ces_gap.speed_map import learn_map
from ces_gap.trace import Inputs, Trace

F = NDArray[np.float64]

GAP = Parameter("gap_m", 0.0, 0.01, (5e-4, 2e-3), "free play from stop to stop", magnitude=True)
SLOW = 0.03  # of the RMS speed: below it the damper stands


@dataclass(frozen=True)
class HeldPlay(Effect):
    """Play z in [-gap/2, gap/2]: x' = x - z, crossed only once the force has come down to zero and turned over.

    The joint stays in contact while its force lasts (a brake unloads its elastic part first; in a damper, force and
    speed turn together), then dz/dt = v and the damper stands. Source: play whose contact is lost at no force (Nordin
    and Gutman, Automatica 38, 2002). Worn rod ends have tenths of a millimetre, linkages and brakes several.
    """

    name, form, stage, reruns, needs = "backlash", "held", MOTION, True, "reversals"
    parameters = (GAP,)

    def drive(self, trace: Trace, inputs: Inputs, force: F, values: Sequence[float]) -> Inputs:
        """Return the damper's own motion."""
        acting = force - learn_map(trace, trace.inputs, force).rest(inputs.current)
        pushed = 0.5 * (1.0 + np.tanh(acting / soft_width(trace, acting)))
        return less(inputs, gated_play(inputs.position, pushed, values[0]), trace.rate_Hz)


@dataclass(frozen=True)
class PartedPlay(HeldPlay):
    """The same, and no force passes while the damper stands: F·w, w = (v'² + ε²)/(v'² + (v - v')² + ε²).

    It differs where the simulation still has a force at standstill (gas, a friction that holds). Source as above.
    """

    form = "parted"

    def respond(self, trace: Trace, inputs: Inputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] that passes the joint."""
        own, outer = inputs.speed, trace.inputs.speed
        slow = (SLOW * float(np.sqrt(np.mean(outer**2)))) ** 2 + 1e-12
        return np.asarray(force * (own**2 + slow) / (own**2 + (outer - own) ** 2 + slow))


FORMS = (HeldPlay(), PartedPlay())
