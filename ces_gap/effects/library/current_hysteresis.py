"""Current hysteresis: by remanence of the valve's iron, the same current acts more when falling than when rising."""

from __future__ import annotations

from collections.abc import Sequence

from ces_data.arrays import F
from ces_gap.effects.effect import VALVE, Effect, EffectParameter
from ces_gap.effects.effect_kernels import coleman_hodgdon, mean_of_plays
from ces_gap.trace import Trace, TraceInputs

PLAYS = 8
HYSTERESIS = EffectParameter("hysteresis_A", 0.0, 0.5, (0.02, 0.1), "half-width of the hysteresis loop", magnitude=True)


class CurrentHysteresis(Effect):
    """What all forms share."""

    name, stage, reruns, needs = "current_hysteresis", VALVE, True, "a current that reverses"
    summary = "magnetic hysteresis of the valve"


class Plays(CurrentHysteresis):
    """Prandtl-Ishlinskii: i' is the mean of eight play operators of i, half-widths evenly up to twice hysteresis_A.

    Slope 1 on a long branch, where i' lags i by 1.125 hysteresis_A. Source: Kuhnen, European Journal of Control 9
    (2003). Proportional solenoids have 2 to 10 % of their range, worn or undithered ones more.
    """

    form = "plays"
    parameters = (HYSTERESIS,)

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        """Return the inputs with the acting current."""
        return inputs.with_current(mean_of_plays(inputs.current, 2.0 * values[0], PLAYS))


class Remanence(CurrentHysteresis):
    """Coleman-Hodgdon: i' = i + h, dh = -(hysteresis_A·di + h·|di|)/travel_A: remanence, reversed by a travel of i.

    Source: Coleman and Hodgdon, Int. J. Engineering Science 24 (1986). The travel is a coercive current, some tenths of
    the valve's range.
    """

    form = "remanence"
    parameters = (
        HYSTERESIS,
        EffectParameter("travel_A", 0.01, 2.0, (0.05, 0.3), "change of current that reverses it", "log"),
    )

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        """Return the inputs with the acting current."""
        return inputs.with_current(inputs.current + coleman_hodgdon(inputs.current, values[0], values[1]))


FORMS = (Plays(), Remanence())
