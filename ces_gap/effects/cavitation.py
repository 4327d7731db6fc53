"""Cavitation: a chamber not filled fast enough opens a void, which must close before force builds up again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ces_gap.effect import FLUID, Effect, Parameter
from ces_gap.effect_kernels import void
from ces_gap.speed_map import learn_map
from ces_gap.trace import Inputs, Trace

F = NDArray[np.float64]

BUBBLES = Parameter("bubbles_m", 1e-4, 5e-3, (5e-4,), "last of the void, over which the force returns", "log")
ROUNDED = 0.05  # of a limit: how gradually it is reached
# Starts of the limits are these shares of what a trace has in the direction that cavitates.
QUANTILES = (0.2, 0.3, 0.4, 0.5, 0.6, 0.75)
SOFT_M = 2e-3  # [m] bubbles at the start: a search that begins with a sharp edge gets stuck beside it
REBOUND, COMPRESSION = -1.0, 1.0


@dataclass(frozen=True)
class _Void(Effect):
    """A void of length z that opens in the direction `side`: on the way back exp(-z/bubbles) of the force is left."""

    name, stage, needs = "cavitation", FLUID, "fast strokes followed by reversals"
    side: ClassVar[float] = 1.0

    def respond(self, trace: Trace, inputs: Inputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] with what the void takes; what it is at standstill stays."""
        share, limit, bubbles = values
        rest = learn_map(trace, inputs, force).rest(inputs.current)
        onward, pull = self.side * inputs.speed, self.side * (force - rest)
        rate, capped = self.opening(onward, pull, share, limit)
        length = void(rate, trace.step_s)
        left = np.where(pull < 0.0, pull * np.exp(-length / bubbles), capped)
        return np.asarray(force + self.side * (left - pull))

    def opening(self, onward: F, pull: F, share: float, limit: float) -> tuple[F, F]:
        """Return how fast the void opens [m/s] and the force [N] left while it does, towards `side`."""
        raise NotImplementedError

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        """Return starts, their limits from what this trace has."""
        seen = self.side * self.limited(trace)[trace.usable]
        seen = seen[seen > 0.0]
        low, high = self.parameters[1].low, self.parameters[1].high
        limits = np.clip(np.quantile(seen, QUANTILES), low, high) if len(seen) else [low]
        return [(1.0, float(limit), SOFT_M) for limit in limits]

    def limited(self, trace: Trace) -> F:
        """Return the quantity that the limit is on, positive in compression."""
        raise NotImplementedError


@dataclass(frozen=True)
class _Intake(_Void):
    """The chamber that grows in the direction `side` fills through an intake valve passing no more than `limit_m_s`.

    dz/dt = share·(v - limit) while v is in that direction, v - share·limit on the way back, z >= 0. Source: base-valve
    cavitation of twin-tube dampers (Dixon, The Shock Absorber Handbook, 2007; Duym, Vehicle System Dynamics 33, 2000).
    Intakes starve from tenths of a metre a second; `share` is the ratio of the areas behind and before the piston.
    """

    parameters = (
        Parameter("share", 0.0, 3.0, (0.3, 1.0), "void opened per stroke not filled, a ratio of areas", magnitude=True),
        Parameter("limit_m_s", 0.02, 3.0, (0.1, 0.3), "speed from which the intake starves", "log"),
        BUBBLES,
    )

    def opening(self, onward: F, pull: F, share: float, limit: float) -> tuple[F, F]:
        """Return how fast the void opens [m/s]; the force of the other chamber is not limited."""
        forth, back = np.maximum(onward, 0.0), np.minimum(onward, 0.0)
        return share * (forth - limit) + back, pull

    def limited(self, trace: Trace) -> F:
        """Return the speed."""
        return trace.inputs.speed


@dataclass(frozen=True)
class _Floor(_Void):
    """The pressure behind the piston falls from the gas charge to nothing: no more than `limit_N` can build up.

    F is held at the limit (by the `share` of the flow that is so charged); the void takes the stroke that no longer
    passes the valve, dz/dt = share·v·(F - limit)/F, and refills by the way back. Source: monotube dampers and their gas
    charge (Dixon 2007): 10 to 30 bar on 1e-4 to 1e-3 m².
    """

    parameters = (
        Parameter("share", 0.0, 1.0, (0.3, 1.0), "share of the flow that is limited", magnitude=True),
        Parameter("limit_N", 30.0, 1e4, (300.0, 1000.0), "force at which the pressure behind is gone", "log"),
        BUBBLES,
    )

    def opening(self, onward: F, pull: F, share: float, limit: float) -> tuple[F, F]:
        """Return how fast the void opens [m/s] and the force [N] that is left."""
        width = ROUNDED * limit
        excess = width * np.logaddexp(0.0, (pull - limit) / width)
        forth, back = np.maximum(onward, 0.0), np.minimum(onward, 0.0)
        spare = np.minimum(pull - limit, 0.0)
        rate = share * forth * (excess + spare) / np.maximum(np.abs(pull), 0.1 * limit) + back
        return rate, pull - share * excess

    def limited(self, trace: Trace) -> F:
        """Return the simulated force."""
        return trace.simulated


@dataclass(frozen=True)
class ReboundIntake(_Intake):
    """After fast rebound the force of compression is lost. Equations, source and range: `_Intake`."""

    form, side = "rebound_intake", REBOUND


@dataclass(frozen=True)
class CompressionIntake(_Intake):
    """After fast compression the force of rebound is lost. Equations, source and range: `_Intake`."""

    form, side = "compression_intake", COMPRESSION


@dataclass(frozen=True)
class ReboundFloor(_Floor):
    """After hard rebound the force of compression is lost. Equations, source and range: `_Floor`."""

    form, side = "rebound_floor", REBOUND


@dataclass(frozen=True)
class CompressionFloor(_Floor):
    """After hard compression the force of rebound is lost. Equations, source and range: `_Floor`."""

    form, side = "compression_floor", COMPRESSION


FORMS = (ReboundIntake(), CompressionIntake(), ReboundFloor(), CompressionFloor())
