"""Cavitation: a chamber that fills too slowly opens a void, which must close before force builds up again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numba import njit

from ces_data.arrays import F
from ces_gap.effects.effect import FLUID, Effect, EffectParameter, magnitude
from ces_gap.trace import Trace, TraceInputs

BUBBLES = EffectParameter("bubbles_m", 1e-4, 5e-3, (5e-4,), "length of void over which the force returns", "log")
ROUNDED = 0.05  # of a limit: width over which it is reached
# Searches for the limits begin at these quantiles of a trace in the cavitating direction.
QUANTILES = (0.2, 0.3, 0.4, 0.5, 0.6, 0.75)
REACHED = (0.3, 0.5, 0.7, 0.85, 0.93, 0.98)
COLUMNS, STARVED = (0.04, 0.09), (0.75, 0.85, 0.92)  # [m]; starts of a reservoir, quantiles for its limits
SEEPS = 0.01  # of the squared flow: passes an intake without pressure
RELEASED_M = 5e-3  # [m] bubbles at the start with a reservoir: more air comes out of the oil
SOFT_M = 2e-3  # [m] bubbles at the start: from a sharp edge a search does not converge
HALVINGS, MIN_SLOPE_NS_M = 8, 50.0  # bisections of the speed; [N s/m]
REBOUND, COMPRESSION = -1.0, 1.0


class Cavitation(Effect):
    """A void that opens in rebound takes force in compression, one that opens in compression takes force in rebound."""

    name, stage, needs = "cavitation", FLUID, "fast strokes followed by reversals"
    summary, moves = "a void forms in a fast stroke and must refill", ("refilling",)
    visible, mistaken_for = "after fast strokes, on the way back", ("backlash", "compressibility")
    side: ClassVar[float] = 1.0

    def limit_starts(self, values: F, quantiles: Sequence[float]) -> list[float]:
        """Return quantiles of the values towards `side`, within the bounds of the limit."""
        positive, limit = self.side * values[self.side * values > 0.0], self.parameters[1]
        if not len(positive):
            return [limit.low]
        return [float(v) for v in np.clip(np.quantile(positive, quantiles), limit.low, limit.high)]


class _Intake(Cavitation):
    """An intake passes at most `limit_m_s`; a void z opens by dz/dt = share·(v - limit), on the return v - share·limit.

    On the return exp(-z/bubbles) of the force remains, and the force at standstill; v is positive in the direction
    `side`. Source: base valves of twin-tube dampers (Dixon 2007; Duym, Vehicle System Dynamics 33, 2000), which starve
    from tenths of a metre per second.
    """

    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        magnitude("share", 0.0, 3.0, (0.3, 1.0), "void per stroke not filled, a ratio of areas"),
        EffectParameter("limit_m_s", 0.02, 3.0, (0.1, 0.3), "speed from which the intake starves", "log"),
        BUBBLES,
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        share, limit, bubbles = values[0], self.limits(inputs, values), values[2]
        rest = trace.learn_map(inputs, force).rest(inputs.current)
        onward, pull = self.side * inputs.speed, self.side * (force - rest)
        length = void(share * (np.maximum(onward, 0.0) - limit) + np.minimum(onward, 0.0), trace.step_s)
        remaining = np.where(pull < 0.0, pull * np.exp(-length / bubbles), pull)
        return np.asarray(force + self.side * (remaining - pull))

    def limits(self, inputs: TraceInputs, values: Sequence[float]) -> float | F:
        """Return the limit: one for all ticks, or one for each (n,)."""
        return values[1]

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        return [(1.0, limit, SOFT_M) for limit in self.limit_starts(trace.inputs.speed[trace.usable], QUANTILES)]


class _Floor(Cavitation):
    """The pressure behind the piston is zero at the force L; a void z takes the flow: dz/dt = v - c u, z >= 0.

    u is the speed at which the simulation has L. Until the void has closed the force stays at L:
    F - r (F - L) (1 - exp(-(z/bubbles)²)), r the `share`. Source: monotube dampers (Dixon 2007), L of 0.1 to 3 kN.
    """

    parameters = (
        magnitude("share", 0.0, 1.0, (0.3, 1.0), "share of the flow that is limited"),
        EffectParameter("limit_N", 30.0, 1e4, (300.0, 1000.0), "force at which the pressure behind is zero", "log"),
        BUBBLES,
        EffectParameter("passing_share", 0.3, 1.5, (1.0,), "flow of the valve during a void, relative to its map"),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        share, limit, bubbles, passing = values
        pull, onward = self.side * force, self.side * inputs.speed
        passed = passing * self._valve_speed_at_limit(trace, inputs, force, limit)
        length = void_length_at_limit(pull, onward, limit, passed, trace.step_s)
        width = ROUNDED * limit
        excess = width * np.logaddexp(0.0, (pull - limit) / width)
        hold = -np.expm1(-((length / bubbles) ** 2))
        return np.asarray(force - self.side * share * (excess + hold * (pull - limit - excess)))

    def _valve_speed_at_limit(self, trace: Trace, inputs: TraceInputs, force: F, limit: float) -> F:
        """Return the speed [m/s] (n,) at which the valve force equals the limit: bisection, then Newton."""
        plant = trace.learn_map(inputs, force)
        most = float(np.max(np.abs(inputs.speed)))
        speed, width = np.full_like(force, 0.5 * most), 0.25 * most
        for _ in range(HALVINGS):
            speed = speed + np.where(plant.force(self.side * speed, inputs.current) * self.side < limit, width, -width)
            width *= 0.5
        for _ in range(2):
            reached, slope = plant.force_and_slope(self.side * speed, inputs.current)
            off = (limit - self.side * reached) / np.maximum(slope, MIN_SLOPE_NS_M)
            speed = np.clip(speed + np.clip(off, -4.0 * width, 4.0 * width), 0.0, most)
        return speed

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        limits = self.limit_starts(trace.simulated[trace.usable], REACHED)
        return [(1.0, limit, SOFT_M, 1.0) for limit in limits]


class ReboundIntake(_Intake):
    """In rebound."""

    form, side = "rebound_intake", REBOUND


class ReboundReservoir(_Intake):
    """As `rebound_intake`, fed by a gas charge that falls as the rod leaves: limit·√(1 + x/column).

    Source: orifice flow √(2Δp/ρ) (Merritt, Hydraulic Control Systems, 1967).
    """

    form, side = "rebound_reservoir", REBOUND
    parameters = (
        *_Intake.parameters[:2],
        replace(BUBBLES, high=0.02),
        EffectParameter("column_m", 0.03, 3.0, COLUMNS, "rod extension that exhausts the reservoir pressure", "log"),
    )

    def limits(self, inputs: TraceInputs, values: Sequence[float]) -> F:
        """Return the speed [m/s] (n,) from which the intake starves."""
        return np.asarray(values[1] * _reservoir_flow_factor(inputs.position, values[3]))

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        speed, position = trace.inputs.speed[trace.usable], trace.inputs.position[trace.usable]
        limits = {c: self.limit_starts(speed / _reservoir_flow_factor(position, c), STARVED) for c in COLUMNS}
        return [(1.0, limit, RELEASED_M, column) for column in COLUMNS for limit in limits[column]]


def _reservoir_flow_factor(position: F, column_m: float) -> F:
    """Return the flow (n,) of an intake relative to that at position zero."""
    return np.asarray(np.sqrt(np.maximum(1.0 + position / column_m, 0.0) + SEEPS))


class CompressionIntake(_Intake):
    """In compression."""

    form, side = "compression_intake", COMPRESSION


class ReboundFloor(_Floor):
    """In rebound."""

    form, side = "rebound_floor", REBOUND


class CompressionFloor(_Floor):
    """In compression."""

    form, side = "compression_floor", COMPRESSION


@njit(cache=True, nogil=True, error_model="numpy")
def void(rate: F, step_s: float) -> F:
    """Return the length [m] (n,), at least 0, of a void that opens at `rate` [m/s] (n,)."""
    out = np.empty_like(rate)
    z = 0.0
    out[0] = z
    for k in range(1, len(rate)):
        z = max(z + 0.5 * (rate[k - 1] + rate[k]) * step_s, 0.0)
        out[k] = z
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def void_length_at_limit(pull: F, onward: F, limit: float, passed: F, step_s: float) -> F:
    """Return the length [m] (n,) of a void that opens where the force `pull` [N] (n,) exceeds `limit`.

    It grows by the speed `onward` minus the flow `passed` of the valve, both [m/s] (n,), until it has closed. The
    instant of opening is interpolated between ticks, so that the length is continuous in `limit`.
    """
    out = np.zeros_like(pull)
    z = 0.0
    for k in range(1, len(pull)):
        if z > 0.0:
            z = max(z + 0.5 * (onward[k - 1] + onward[k] - passed[k - 1] - passed[k]) * step_s, 0.0)
        elif pull[k] > limit:
            rise = pull[k] - pull[k - 1]
            since = min(max((limit - pull[k - 1]) / rise, 0.0), 1.0) if rise > 0.0 else 1.0
            opened = onward[k - 1] + since * (onward[k] - onward[k - 1])
            z = max((0.5 * (onward[k] + opened) - passed[k]) * (1.0 - since) * step_s, 0.0)
        out[k] = z
    return out
