"""A relaxation model: a spring in series with a valve and yielding springs (a nonlinear Maxwell element).

    compliance (y(k) - y(k-1)) + T (q(k) + leak y(k)) = T drive(k)
    y(k)   = map(q(k), setting(k)) + sum_j h_j(k),  h_j(k) = clip(h_j(k-1) + stiffness_j T q(k), -+yield_j(setting(k)))
    force  = y(k) + side force(k)

A run starts with h_j = 0, and springs that do not yield within the stroke stretched from mid-stroke (`restoring`).
y is the force [N] in oil and mounts, q the speed [m/s] at which the oil passes the valve. The map rises with q, so each
step has one solution, and for two runs with the same inputs and settings, with dy, dh and dq their differences,

    compliance dy (dy - dy(k-1)) + T (dq + leak dy) dy = 0,  dq dy >= sum_j dh_j (dh_j - dh_j(k-1)) / (T stiffness_j),

so compliance dy^2 + sum_j dh_j^2 / stiffness_j never grows (Moreau 1977 for the yielding springs). If |y(k)| exceeded
the map at the largest drive plus all yield forces, |q| would exceed the drive and |y(k)| < |y(k-1)|: a run, which
starts within them, never does. That is the bound.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

from ces_observer.errors import ModelError
from ces_observer.json_checks import JsonObject
from ces_observer.structures.flow_map import FlowMap, parse_growth
from ces_observer.structures.increasing_curves import MAX_VALUE
from ces_observer.structures.physical_structure import PhysicalStructure, yield_at_mid_stroke
from ces_observer.structures.reach import MAX_REACH
from ces_observer.structures.relaxation_run import RelaxationRun
from ces_observer.structures.side_forces import SideForces
from ces_observer.structures.structure import OperatingRange, Ranges
from ces_observer.structures.valve_path import ValvePath

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
