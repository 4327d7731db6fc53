"""Current hysteresis: by remanence of the valve's iron, the same current acts more when falling than when rising."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp

import numpy as np
from numba import njit

from ces_data.arrays import F
from ces_gap.effects.effect import VALVE, Effect, EffectParameter, magnitude
from ces_gap.trace import Trace, TraceInputs

PLAYS = 8
HYSTERESIS = magnitude("hysteresis_A", 0.0, 5.0, (0.02, 0.1), "half-width of the hysteresis loop", usual=(0.0, 0.5))


class CurrentHysteresis(Effect):
    name, stage, reruns, needs = "current_hysteresis", VALVE, True, "a current that reverses"
    summary = "magnetic hysteresis of the valve"
    visible, mistaken_for = "when the current reverses", ("valve_lag",)
    bench = ("over_current", "width_N")


class Plays(CurrentHysteresis):
    """Prandtl-Ishlinskii: i' is the mean of eight play operators of i, half-widths evenly up to twice hysteresis_A.

    Source: Kuhnen, European Journal of Control 9 (2003). Proportional solenoids have 2 to 10 % of their range, worn or
    undithered ones more.
    """

    form = "plays"
    parameters = (HYSTERESIS,)

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        return inputs.with_current(mean_of_plays(inputs.current, 2.0 * values[0], PLAYS))


class Remanence(CurrentHysteresis):
    """Coleman-Hodgdon: i' = i + h, dh = -(hysteresis_A·di + h·|di|)/travel_A: remanence, reversed by a travel of i.

    Source: Coleman and Hodgdon, Int. J. Engineering Science 24 (1986).
    """

    form = "remanence"
    parameters = (
        HYSTERESIS,
        EffectParameter("travel_A", 0.01, 2.0, (0.05, 0.3), "change of current that reverses it", "log"),
    )

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        return inputs.with_current(inputs.current + coleman_hodgdon(inputs.current, values[0], values[1]))


@njit(cache=True, nogil=True, error_model="numpy")
def mean_of_plays(u: F, widest: float, count: int) -> F:
    """Return the mean (n,) of `count` play operators of u, half-widths evenly up to `widest`, initially centred."""
    out = u.copy()
    for j in range(1, count + 1):
        radius = widest * j / count
        z = u[0]
        for k in range(len(u)):
            z = min(max(z, u[k] - radius), u[k] + radius)
            out[k] += (z - u[k]) / count
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def coleman_hodgdon(u: F, height: float, travel: float) -> F:
    """Return h (n,) of dh/du = -(height + h)/travel for rising u, (height - h)/travel for falling; h(0) = 0."""
    out = np.empty_like(u)
    h = 0.0
    out[0] = h
    for k in range(1, len(u)):
        step = u[k] - u[k - 1]
        target = -height if step > 0.0 else height
        h = target + (h - target) * exp(-abs(step) / travel)
        out[k] = h
    return out
