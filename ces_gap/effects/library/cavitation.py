"""Cavitation: a chamber not filled fast enough opens a void, which must close before force builds up again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from ces_gap.effects.cavitation_kernels import void_length_at_limit
from ces_gap.effects.effect import FLUID, Effect, EffectParameter
from ces_gap.effects.effect_kernels import void
from ces_gap.trace import F, Trace, TraceInputs

BUBBLES = EffectParameter("bubbles_m", 1e-4, 5e-3, (5e-4,), "last of the void, over which the force returns", "log")
ROUNDED = 0.05  # of a limit: how gradually it is reached
# Starts of the limits are these shares of what a trace has in the direction that cavitates.
QUANTILES = (0.2, 0.3, 0.4, 0.5, 0.6, 0.75)
REACHED = (0.3, 0.5, 0.7, 0.85, 0.93, 0.98)
COLUMNS, STARVED = (0.04, 0.09), (0.75, 0.85, 0.92)  # [m]; starts of a reservoir, and quantiles for its limits
SEEPS = 0.01  # of the square: what an intake passes when no pressure is left
RELEASED_M = 5e-3  # [m] bubbles at the start beside a reservoir: as below, and more air comes out of the oil
SOFT_M = 2e-3  # [m] bubbles at the start: a search that begins with a sharp edge gets stuck beside it
HALVINGS, MIN_SLOPE_NS_M = 8, 50.0  # of the speed; [N s/m]
REBOUND, COMPRESSION = -1.0, 1.0


class _Void(Effect):
    """A void of length z that opens in the direction `side`: on the way back exp(-z/bubbles) of the force is left."""

    name, stage, needs = "cavitation", FLUID, "fast strokes followed by reversals"
    side: ClassVar[float] = 1.0

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] with what the void takes; what it is at standstill stays."""
        share, limit, bubbles = values[0], self.limits(inputs, values), values[2]
        rest = trace.learn_map(inputs, force).rest(inputs.current)
        onward, pull = self.side * inputs.speed, self.side * (force - rest)
        rate, capped = self.opening(onward, pull, share, limit)
        length = void(rate, trace.step_s)
        left = np.where(pull < 0.0, pull * np.exp(-length / bubbles), capped)
        return np.asarray(force + self.side * (left - pull))

    def limits(self, inputs: TraceInputs, values: Sequence[float]) -> float | F:
        """Return the limit, of all ticks or of each (n,)."""
        return values[1]

    def opening(self, onward: F, pull: F, share: float, limit: float | F) -> tuple[F, F]:
        """Return how fast the void opens [m/s] and the force [N] left while it does, towards `side`."""
        raise NotImplementedError

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        """Return starts, their limits from what this trace has."""
        seen = self.side * self.limited_quantity(trace)[trace.usable]
        seen = seen[seen > 0.0]
        low, high = self.parameters[1].low, self.parameters[1].high
        limits = np.clip(np.quantile(seen, QUANTILES), low, high) if len(seen) else [low]
        return [(1.0, float(limit), SOFT_M) for limit in limits]

    def limited_quantity(self, trace: Trace) -> F:
        """Return the quantity that the limit is on, positive in compression."""
        raise NotImplementedError


class _Intake(_Void):
    """The chamber that grows in the direction `side` fills through an intake valve passing no more than `limit_m_s`.

    dz/dt = share·(v - limit) while v is in that direction, v - share·limit on the way back, z >= 0. Source: base-valve
    cavitation of twin-tube dampers (Dixon, The Shock Absorber Handbook, 2007; Duym, Vehicle System Dynamics 33, 2000).
    Intakes starve from tenths of a metre a second; `share` is the ratio of the areas behind and before the piston.
    """

    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(
            "share", 0.0, 3.0, (0.3, 1.0), "void opened per stroke not filled, a ratio of areas", magnitude=True
        ),
        EffectParameter("limit_m_s", 0.02, 3.0, (0.1, 0.3), "speed from which the intake starves", "log"),
        BUBBLES,
    )

    def opening(self, onward: F, pull: F, share: float, limit: float | F) -> tuple[F, F]:
        """Return how fast the void opens [m/s]; the force of the other chamber is not limited."""
        forth, back = np.maximum(onward, 0.0), np.minimum(onward, 0.0)
        return share * (forth - limit) + back, pull

    def limited_quantity(self, trace: Trace) -> F:
        """Return the speed."""
        return trace.inputs.speed


class _Floor(_Void):
    """The pressure behind the piston falls from the gas charge to nothing: no more than `limit_N` can build up.

    The void takes what the valve does not pass, dz/dt = v - c u, z >= 0, u being the speed at which the plant's map has
    the limit L at this current. Until it has closed the force stays at L, even where the damper alone would have less
    or has turned back: F - r (F - L) (1 - exp(-(z/bubbles)2)), r the `share`. Source: monotube dampers and their
    gas charge (Dixon 2007): 10 to 30 bar on 1e-4 to 1e-3 m².
    """

    parameters = (
        EffectParameter("share", 0.0, 1.0, (0.3, 1.0), "share of the flow that is limited", magnitude=True),
        EffectParameter("limit_N", 30.0, 1e4, (300.0, 1000.0), "force at which the pressure behind is gone", "log"),
        BUBBLES,
        EffectParameter("passing_share", 0.3, 1.5, (1.0,), "flow of the valve beside a void, over what its map says"),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N], held while there is a void."""
        share, limit, bubbles, passing = values
        pull, onward = self.side * force, self.side * inputs.speed
        passed = passing * self._valve_speed_at_limit(trace, inputs, force, limit)
        length = void_length_at_limit(pull, onward, limit, passed, trace.step_s)
        width = ROUNDED * limit
        excess = width * np.logaddexp(0.0, (pull - limit) / width)
        hold = -np.expm1(-((length / bubbles) ** 2))
        return np.asarray(force - self.side * share * (excess + hold * (pull - limit - excess)))

    def _valve_speed_at_limit(self, trace: Trace, inputs: TraceInputs, force: F, limit: float) -> F:
        """Return the speed [m/s] (n,) at which the valve holds the limit at the tick's current, by bisection."""
        plant = trace.learn_map(inputs, force)
        most = float(np.max(np.abs(inputs.speed)))
        speed, width = np.full_like(force, 0.5 * most), 0.25 * most
        for _ in range(HALVINGS):
            speed = speed + np.where(plant.force(self.side * speed, inputs.current) * self.side < limit, width, -width)
            width *= 0.5
        for _ in range(2):
            found, slope = plant.force_and_slope(self.side * speed, inputs.current)
            off = (limit - self.side * found) / np.maximum(slope, MIN_SLOPE_NS_M)
            speed = np.clip(speed + np.clip(off, -4.0 * width, 4.0 * width), 0.0, most)
        return speed

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        """Return limits that this trace reaches, from often to hardly."""
        seen = self.side * trace.simulated[trace.usable]
        seen = seen[seen > 0.0]
        limits = np.clip(np.quantile(seen, REACHED), 30.0, 1e4) if len(seen) else [30.0]
        return [(1.0, float(limit), SOFT_M, 1.0) for limit in limits]


class ReboundIntake(_Intake):
    """After fast rebound the force of compression is lost. Equations, source and range: `_Intake`."""

    form, side = "rebound_intake", REBOUND


class ReboundReservoir(_Intake):
    """As `ReboundIntake`, fed through an orifice by a gas charge that falls as the rod leaves: limit·√(1 + x/column).

    Source: orifice flow √(2Δp/ρ) (Merritt 1967), Δp from the reservoir's gas (Dixon 2007) down to the pressure at which
    air and vapour come out. `column_m` is how far out from the position's zero the rod is when nothing of Δp is left.
    """

    form, side = "rebound_reservoir", REBOUND
    parameters = (
        *_Intake.parameters[:2],
        replace(BUBBLES, high=0.02),
        EffectParameter("column_m", 0.03, 3.0, COLUMNS, "rod's way out that uses up the reservoir's pressure", "log"),
    )

    def limits(self, inputs: TraceInputs, values: Sequence[float]) -> F:
        """Return the speed [m/s] (n,) from which the intake starves."""
        return np.asarray(values[1] * _reservoir_flow_factor(inputs.position, values[3]))

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        """Return starts, their limits from the rebound speeds of this trace, each over what the charge lets by."""
        out: list[tuple[float, ...]] = []
        for column in COLUMNS:
            seen = (-trace.inputs.speed / _reservoir_flow_factor(trace.inputs.position, column))[trace.usable]
            seen = seen[seen > 0.0] if (seen > 0.0).any() else np.zeros(1)
            limits = np.clip(np.quantile(seen, STARVED), self.parameters[1].low, self.parameters[1].high)
            out += [(1.0, float(limit), RELEASED_M, column) for limit in limits]
        return out


def _reservoir_flow_factor(position: F, column_m: float) -> F:
    """Return what an intake passes (n,) over what it does at the position's zero."""
    return np.asarray(np.sqrt(np.maximum(1.0 + position / column_m, 0.0) + SEEPS))


class CompressionIntake(_Intake):
    """After fast compression the force of rebound is lost. Equations, source and range: `_Intake`."""

    form, side = "compression_intake", COMPRESSION


class ReboundFloor(_Floor):
    """After hard rebound the force of compression is lost. Equations, source and range: `_Floor`."""

    form, side = "rebound_floor", REBOUND


class CompressionFloor(_Floor):
    """After hard compression the force of rebound is lost. Equations, source and range: `_Floor`."""

    form, side = "compression_floor", COMPRESSION


FORMS = (ReboundIntake(), ReboundReservoir(), CompressionIntake(), ReboundFloor(), CompressionFloor())
