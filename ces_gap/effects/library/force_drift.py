"""Force drift: the cell's zero wanders with time, as it warms or its glue creeps, whatever the damper does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ces_gap.effects.effect import CELL, Effect, EffectParameter
from ces_gap.trace import F, Trace, TraceInputs


class LinearDrift(Effect):
    """A steady drift from a zero that was right when the recording began: F + r t.

    A 10 kN cell that warms by a kelvin a minute drifts by some hundredths of a newton a second, a piezo cell with damp
    insulation by more; gas that warms in the damper raises its force by newtons a second under hard work.
    """

    name, form, stage, needs = "force_drift", "linear", CELL, "at least some ten seconds, tared at the start"
    parameters = (EffectParameter("drift_N_s", -20.0, 20.0, (0.5,), "drift of the zero", magnitude=True),)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) as the cell shows it."""
        return force + values[0] * trace.time_s


class SettlingDrift(Effect):
    """A drift that settles: F + A (1 - exp(-t/tau)), as a cell warms through or a charge leaks away."""

    name, form, stage = "force_drift", "settling", CELL
    needs = "a recording about as long as the drift takes, tared at the start"
    parameters = (
        EffectParameter("settled_N", -2000.0, 2000.0, (20.0,), "drift after a long time", magnitude=True),
        EffectParameter("settling_s", 2.0, 500.0, (8.0, 60.0), "time constant of the drift", "log"),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) as the cell shows it."""
        return force - values[0] * np.expm1(-trace.time_s / values[1])


FORMS = (LinearDrift(), SettlingDrift())
