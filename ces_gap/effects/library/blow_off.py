"""Blow-off: a relief valve opens above a pressure, so that the force grows much less."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.effect import FLUID, Effect, EffectParameter
from ces_gap.trace import Trace, TraceInputs

ROUNDING = 0.02  # of the level: width over which the valve opens
OPENS_AT = (0.97, 0.9, 0.75, 0.55)  # shares of the largest simulated force at which searches begin

SLOPE = EffectParameter("slope", 0.0, 0.9, (0.2,), "slope of the force above the level, relative to no valve")


def _level(side: str) -> EffectParameter:
    what = f"force in {side} at which the valve opens"
    return EffectParameter(
        f"{side}_N", 100.0, 100000.0, (800.0, 2000.0), what, "inverse", magnitude=True, neutral=np.inf
    )


class BlowOff(Effect):
    """What all forms share."""

    name, stage = "blow_off", FLUID
    summary = "a relief valve opens and limits the force"


class OneSide(BlowOff):
    """One valve: above the level L the force is L + s (F - L), rounded over 2 % of L.

    Source: relief valves of dampers (Dixon, The Shock Absorber Handbook, 2nd ed. 2007). They open at 0.5 to 5 kN; the
    slope represents the stiffness of spring and seat, 0 for an ideal valve.
    """

    sign = 1.0

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) with the valve."""
        level, slope = values
        return force - self.sign * (1.0 - slope) * _excess(self.sign * force, level)

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        """Return levels [N] below the largest simulated force on this side, with a slope."""
        return [(level, SLOPE.starts[0]) for level in _levels(trace, self.sign)]


class ReboundBlowOff(OneSide):
    """A valve that opens in rebound."""

    form, sign, needs = "rebound", -1.0, "rebound forces at which the real valve opens"
    parameters = (_level("rebound"), SLOPE)


class CompressionBlowOff(OneSide):
    """A valve that opens in compression."""

    form, needs = "compression", "compression forces at which the real valve opens"
    parameters = (_level("compression"), SLOPE)


class TwoSidedBlowOff(BlowOff):
    """One valve for each direction, each with its level."""

    form, needs = "both", "forces at which the real valves open"
    parameters = (_level("rebound"), _level("compression"), SLOPE)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) with the valves."""
        rebound, compression, slope = values
        return force + (1.0 - slope) * (_excess(-force, rebound) - _excess(force, compression))

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        """Return levels [N] below the largest simulated forces, with a slope."""
        pairs = zip(_levels(trace, -1.0), _levels(trace, 1.0), strict=True)
        return [(rebound, compression, SLOPE.starts[0]) for rebound, compression in pairs]


def _excess(force: F, level: float) -> F:
    """Return the part of the force [N] (n,) above the level, rounded (softplus)."""
    if not np.isfinite(level):
        return np.zeros_like(force)
    width = ROUNDING * level
    beyond = (force - level) / width
    return np.asarray(width * (np.maximum(beyond, 0.0) + np.log1p(np.exp(-np.abs(beyond)))))


def _levels(trace: Trace, sign: float) -> list[float]:
    largest = max(float(np.quantile(sign * trace.simulated, 0.998)), 200.0)
    return [share * largest for share in OPENS_AT]


FORMS = (ReboundBlowOff(), CompressionBlowOff(), TwoSidedBlowOff())
