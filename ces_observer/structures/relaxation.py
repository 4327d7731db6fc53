"""A relaxation model: a spring in series with a valve and yielding springs (a nonlinear Maxwell element).

    compliance (y(k) - y(k-1)) + T (q(k) + leak y(k)) = T drive(k)
    y(k)   = map(q(k), setting(k)) + sum_j h_j(k),  h_j(k) = clip(h_j(k-1) + stiffness_j T q(k), -+yield_j(setting(k)))
    force  = y(k) + side force(k)

A run starts with h_j = 0, and springs that do not yield within the stroke stretched from mid-stroke (`restoring`). y is
the force [N] in oil and mounts, q the speed [m/s] at which the oil passes the valve. The map rises with q, so each step
has one solution, and for two runs with the same inputs and settings, with dy, dh and dq their differences,

    compliance dy (dy - dy(k-1)) + T (dq + leak dy) dy = 0,  dq dy >= sum_j dh_j (dh_j - dh_j(k-1)) / (T stiffness_j),

so compliance dy^2 + sum_j dh_j^2 / stiffness_j never grows (Moreau 1977 for the yielding springs). If |y(k)| exceeded
the map at the largest drive plus all yield forces, |q| would exceed the drive and |y(k)| < |y(k-1)|: a run, which
starts within them, never does. That is the bound.

Seen from the speed q that passes the valve, the force of the oil is piecewise linear and rising: its breakpoints are
those of the valve's map and the speeds at which springs yield. A step starts on the piece of the last one and follows
Newton's method from piece to piece, which mostly ends at once; if not, it finds the piece by bisection.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import copysign
from typing import Any, ClassVar, Self

from ces_observer.errors import ModelError
from ces_observer.json_text import JsonObject
from ces_observer.structures.curves import MAX_VALUE, FlowMap, parse_growth, pieces, place_inside
from ces_observer.structures.physical import (
    MAX_REACH,
    InputLimiter,
    PhysicalStructure,
    SideForces,
    SideRun,
    ValvePath,
    ValveRun,
    yield_at_mid_stroke,
)
from ces_observer.structures.structure import OperatingRange, Ranges, hold

QUICK_STEPS = 8  # from piece to piece, before the bisection
CLOSE = 1e-13  # relative change of the passed speed that ends a step

CurvePiece = tuple[float, float, float, float, float]
"""Speed [m/s], force [N] and slope at the left node of a piece, and how far the next row's force and slope differ."""
SpringPair = tuple[int, float, float, float]
"""Number of a spring, its stiffness times T, its yield force [N] at a row, and how far that at the next row differs."""


class RelaxationRun:
    """The free run of a relaxation model; `clamped`, `held`: the last inputs, force were outside the envelope."""

    def __init__(self, model: Relaxation, within: OperatingRange) -> None:
        interval = 1.0 / within.rate_Hz
        self._inputs = InputLimiter(within, model.reach)
        self._valve = ValveRun(model.valve, interval)
        self._side = SideRun(model.side, interval)
        self._numbers = interval, model.compliance_m_N, model.compliance_m_N + interval * model.leak_m_Ns
        self._inner = model.map.at[1:-1]
        self._top = len(model.map.rows) - 1
        self._rows = [_blend(model, n, interval) for n in range(self._top + 1)]
        self._restoring, self._middle = model.restoring, model.mid_stroke_m
        self._limits = within.force_N
        self.reset()

    @property
    def clamped(self) -> bool:
        """True if the last inputs lay outside the envelope."""
        return self._inputs.outside

    def reset(self) -> None:
        """Forget the past."""
        self._valve.reset()
        self._side.reset()
        self._force = self._passed = 0.0
        self._stretched = [0.0] * len(self._restoring)
        self._started = False
        self._inputs.outside = self.held = False

    def tick(self, position: float, speed: float, current: float) -> float:
        """Return the force [N] at this tick, held in its envelope; infinite if it is not finite."""
        position, speed, current = self._inputs.limit(position, speed, current)
        if not self._started:
            self._start(position)
        drive, side = self._side.tick(position, speed)
        force = self._advance(drive, self._valve.tick(current)) + side
        low, high = self._limits
        self.held = not low <= force <= high
        return hold(force, low, high) if self.held else force

    def _start(self, position: float) -> None:
        self._started = True
        stretch = position - self._middle
        self._stretched = [min(max(k * stretch, -limit), limit) for k, limit in self._restoring]
        self._force = sum(self._stretched)

    def _advance(self, drive: float, setting: float) -> float:
        """Solve the step for the passed speed q; return the force of the oil [N]."""
        interval, compliance, held = self._numbers
        share = setting * self._top
        row = int(share)
        share -= row
        curve, yields = self._rows[row]
        springs = [(n, step, limit + share * rise) for n, step, limit, rise in yields]
        inner, stretched = self._inner, self._stretched
        target = interval * drive + compliance * self._force
        q = self._passed
        for _ in range(QUICK_STEPS):
            at, force, slope, rise, steeper = curve[bisect_left(inner, q)]
            slope += share * steeper
            force += share * rise - slope * at
            for n, step, limit in springs:
                h = stretched[n]
                if h + step * q > limit:
                    force += limit
                elif h + step * q < -limit:
                    force -= limit
                else:
                    force += h
                    slope += step
            before, q = q, (target - held * force) / (held * slope + interval)
            if -CLOSE <= q - before <= CLOSE or abs(q - before) <= CLOSE * abs(q):
                break
        else:
            q, force, slope = self._search(target, curve, share, springs)
        force += slope * q
        for n, step, limit in springs:
            h = stretched[n] + step * q
            stretched[n] = limit if h > limit else -limit if h < -limit else h
        self._passed, self._force = q, force
        return force

    def _search(
        self, target: float, curve: Sequence[CurvePiece], share: float, springs: Sequence[tuple[int, float, float]]
    ) -> tuple[float, float, float]:
        """Return the passed speed [m/s], and the force at q = 0 and slope of its piece; bisects the breakpoints."""
        interval, _, held = self._numbers
        yields = [(side * limit - self._stretched[n]) / step for n, step, limit in springs for side in (-1.0, 1.0)]
        ends = sorted([*self._inner, *yields])

        def line(q: float) -> tuple[float, float]:
            at, force, slope, rise, steeper = curve[bisect_left(self._inner, q)]
            slope += share * steeper
            force += share * rise - slope * at
            for n, step, limit in springs:
                h = self._stretched[n]
                if abs(h + step * q) > limit:
                    force += copysign(limit, h + step * q)
                else:
                    force, slope = force + h, slope + step
            return force, slope

        def excess(q: float) -> float:
            force, slope = line(q)
            return held * (force + slope * q) + interval * q - target

        force, slope = line(place_inside(ends, bisect_left(ends, 0.0, key=excess)))
        return (target - held * force) / (held * slope + interval), force, slope


def _blend(model: Relaxation, row: int, interval: float) -> tuple[list[CurvePiece], list[SpringPair]]:
    """Return the curves' pieces and the yield forces between a row and the next; the last row is its own next."""
    following = min(row + 1, len(model.map.rows) - 1)
    here, there = (pieces(model.map.at, model.map.rows[n]) for n in (row, following))
    curve = [(x, y, slope, b - y, steeper - slope) for (x, y, slope), (_, b, steeper) in zip(here, there, strict=True)]
    springs = [(one.yield_N[row], one.yield_N[following], one.stiffness_N_m) for one in model.springs]
    return curve, [(n, k * interval, low, high - low) for n, (low, high, k) in enumerate(springs)]


MAX_SPRINGS = 8
METHOD = "all curves rise; |y| falls wherever the valve passes more than the largest drive"


@dataclass(frozen=True)
class YieldingSpring:
    """A spring whose force is limited by the valve's setting: stiffness [N/m], yield force [N] at each map row."""

    stiffness_N_m: float
    yield_N: tuple[float, ...]

    def at_mid_stroke(self, half_m: float) -> Self:
        """Return the spring with the yield forces that it has in the middle of strokes to +-`half_m` [m]."""
        limits = (yield_at_mid_stroke(self.stiffness_N_m, limit, half_m) for limit in self.yield_N)
        return replace(self, yield_N=tuple(limits))


@dataclass(frozen=True)
class Relaxation(PhysicalStructure):
    """A relaxation model: compliance [m/N] and leak [m/(N s)] in series with the valve's map of force over speed."""

    name: ClassVar[str] = "relaxation"
    keys: ClassVar[tuple[str, ...]] = ("relaxation",)
    option: ClassVar[str] = "relaxation"
    rank: ClassVar[int] = 3
    method: ClassVar[str] = METHOD

    valve: ValvePath
    compliance_m_N: float
    leak_m_Ns: float
    map: FlowMap
    springs: tuple[YieldingSpring, ...]
    side: SideForces
    reach: float

    @property
    def restoring(self) -> tuple[tuple[float, float], ...]:
        """Stiffness [N/m] and least yield force [N] of each spring that does not yield within the stroke, else zeros.

        Such a spring is a restoring force that leaks away slowly. A run starts with it stretched from mid-stroke: it
        would keep another start for as long as it does not yield.
        """
        stroke = self.side.position_m[-1] - self.side.position_m[0]
        return tuple(
            (one.stiffness_N_m, min(one.yield_N)) if min(one.yield_N) >= one.stiffness_N_m * stroke else (0.0, 0.0)
            for one in self.springs
        )

    @property
    def mid_stroke_m(self) -> float:
        """Position [m] at which restoring springs are free."""
        return 0.5 * (self.side.position_m[0] + self.side.position_m[-1])

    @property
    def size(self) -> str:
        """The size, in words."""
        return f"{len(self.map.rows)} force-speed curves of {len(self.map.at)} nodes, {len(self.springs)} springs"

    def to_json(self) -> dict[str, Any]:
        """Return the contents of the model file."""
        numbers = {
            "valve": self.valve.to_json(),
            "compliance_m_N": self.compliance_m_N,
            "leak_m_Ns": self.leak_m_Ns,
            "map": self.map.to_json("speed_m_s"),
            "springs": [{"stiffness_N_m": s.stiffness_N_m, "yield_N": list(s.yield_N)} for s in self.springs],
            "side": self.side.to_json(),
            "reach": self.reach,
        }
        return {"relaxation": numbers}

    @classmethod
    def from_json(cls, root: JsonObject, inputs: Ranges) -> Self:
        """Check the relaxation model of a model file; raises ModelError."""
        node = root.at("relaxation")
        node.require_only_keys("valve", "compliance_m_N", "leak_m_Ns", "map", "springs", "side", "reach")
        flow = FlowMap.from_json(node.at("map"), "speed_m_s")
        side = SideForces.from_json(node.at("side"))
        if side.friction:
            raise ModelError(f"{node.where}: side has friction elements; expected none: they are among the springs")
        return cls(
            ValvePath.from_json(node.at("valve")),
            node.number("compliance_m_N", 1e-15, 1.0),
            parse_growth(node, "leak_m_Ns"),
            flow,
            tuple(_parse_spring(item, len(flow.rows)) for item in node.items("springs", 0, MAX_SPRINGS)),
            side,
            node.number("reach", 1.0, MAX_REACH),
        )

    def make_predictor(self, within: OperatingRange) -> RelaxationRun:
        """Return a new free run."""
        return RelaxationRun(self, within)

    def at_full_strokes(self, half_m: float) -> Self:
        """Return the model with the yield forces that its springs have in the middle of strokes to +-`half_m` [m]."""
        return replace(self, springs=tuple(one.at_mid_stroke(half_m) for one in self.springs))

    def bound_force(self, inputs: Ranges) -> float:
        """Return a bound on |force| [N] for inputs in their ranges."""
        passed = self.map.max_force(self.side.max_drive(inputs["speed"]))
        springs = sum(max(one.yield_N) for one in self.springs)
        return (passed + springs + self.side.bound_N(inputs)) * (1.0 + 1e-9)


def _parse_spring(node: JsonObject, rows: int) -> YieldingSpring:
    node.require_only_keys("stiffness_N_m", "yield_N")
    limits = node.numbers("yield_N", rows, MAX_VALUE)
    if min(limits) < 0.0:
        raise ModelError(f"{node.where}: yield_N has {min(limits):g}; expected forces from 0 on")
    return YieldingSpring(node.number("stiffness_N_m", 1e-9, 1e12), limits)
