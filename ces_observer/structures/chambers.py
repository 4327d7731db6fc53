"""A damper's two chambers (thesis fig. 2.3): pressures that build up in elastic oil, and flows between them.

With pressures p_c, p_r above the reservoir's, as forces [N] on the rod side's area, and flows as speeds [m/s] of it:

    s       = (1 + ratio) p_c - p_r                                        force of the oil
    drive   = (1 + ratio) drive(k), -drive(k)                              into compression and rebound chamber
    C_c dp_c/dt + (1 + ratio) M ds/dt = (1 + ratio) drive - check(p_c - p_r) + refill(-p_c)
    C_r dp_r/dt - M ds/dt             = -drive + check(p_c - p_r) - valve(p_r, setting)
    force(k) = s(k) + side force(k),  the friction elements times 1 + growth max(p_r, 0)

M is the compliance [m/N] of mounts in series. Implicit Euler steps; check, refill and valve are increasing, piecewise
linear curves (the valve's as the inverse of its map of force over flow). So with P = (p_c, p_r), a = (1 + ratio, -1),
S = diag(C_c, C_r) + M a a' and L the flows,  S (P(k) - P(k-1)) + T L(P(k)) = T a drive(k).  S is positive definite and
L the gradient of a convex function: a step minimises a convex function and has one solution. Between two runs with the
same inputs and settings, dP' (L(P) - L(Q)) >= 0, so that their difference dP never grows in the norm of S. The energy
1/2 P' S P grows only where P' L(P) < drive a' P, which bounds it: `ces_observer.structures.chambers_bound`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt
from typing import Any, ClassVar, Self

from ces_observer.errors import ModelError
from ces_observer.json_checks import JsonObject
from ces_observer.structures.chambers_bound import ROUNDING, bound_energy
from ces_observer.structures.chambers_run import ChambersRun
from ces_observer.structures.flow_map import FlowMap, parse_growth
from ces_observer.structures.increasing_curves import IncreasingCurve, parse_curve
from ces_observer.structures.physical_structure import PhysicalStructure, yield_at_mid_stroke
from ces_observer.structures.reach import MAX_REACH
from ces_observer.structures.side_forces import SideForces
from ces_observer.structures.structure import OperatingRange, Ranges
from ces_observer.structures.valve_path import ValvePath

METHOD = "all flows rise with their pressure drop; energy bounded over all directions of (p_c, p_r), best first"


@dataclass(frozen=True)
class Chambers(PhysicalStructure):
    """A damper with two chambers; compliances [m/N] of both chambers and of the mounts, flows as speeds [m/s]."""

    name: ClassVar[str] = "chambers"
    keys: ClassVar[tuple[str, ...]] = ("chambers",)
    method: ClassVar[str] = METHOD

    valve: ValvePath
    area_ratio: float
    compression_m_N: float
    rebound_m_N: float
    mount_m_N: float
    check: IncreasingCurve
    refill: IncreasingCurve
    map: FlowMap
    friction_growth_1_N: float
    side: SideForces
    reach: float

    @property
    def size(self) -> str:
        """The size, in words."""
        return f"2 chambers, {len(self.map.rows)} valve curves of {len(self.map.at)} nodes"

    def to_json(self) -> dict[str, Any]:
        """Return the contents of the model file."""
        numbers = {
            "valve": self.valve.to_json(),
            "area_ratio": self.area_ratio,
            "compression_m_N": self.compression_m_N,
            "rebound_m_N": self.rebound_m_N,
            "mount_m_N": self.mount_m_N,
            "check": self.check.to_json("drop_N", "flow_m_s"),
            "refill": self.refill.to_json("drop_N", "flow_m_s"),
            "map": self.map.to_json("flow_m_s"),
            "friction_growth_1_N": self.friction_growth_1_N,
            "side": self.side.to_json(),
            "reach": self.reach,
        }
        return {"chambers": numbers}

    @classmethod
    def from_json(cls, root: JsonObject, inputs: Ranges) -> Self:
        """Check the chambers of a model file; raises ModelError."""
        node = root.at("chambers")
        node.require_only_keys(
            "valve", "area_ratio", "compression_m_N", "rebound_m_N", "mount_m_N", "check", "refill", "map",
            "friction_growth_1_N", "side", "reach",
        )  # fmt: skip
        return cls(
            ValvePath.from_json(node.at("valve")),
            node.number("area_ratio", 0.0, 100.0),
            node.number("compression_m_N", 1e-12, 1.0),
            node.number("rebound_m_N", 1e-12, 1.0),
            node.number("mount_m_N", 0.0, 1.0),
            _parse_flow(node.at("check")),
            _parse_flow(node.at("refill")),
            _parse_map(node.at("map")),
            parse_growth(node, "friction_growth_1_N"),
            SideForces.from_json(node.at("side")),
            node.number("reach", 1.0, MAX_REACH),
        )

    def make_predictor(self, within: OperatingRange) -> ChambersRun:
        """Return a new free run."""
        return ChambersRun(self, within)

    def at_full_strokes(self, half_m: float) -> Self:
        """Return the model with the yield forces that its friction has in the middle of strokes to +-`half_m` [m]."""
        elements = (
            replace(one, yield_N=yield_at_mid_stroke(one.stiffness_N_m, one.yield_N, half_m))
            for one in self.side.friction
        )
        return replace(self, side=replace(self.side, friction=tuple(elements)))

    def bound_force(self, inputs: Ranges) -> float:
        """Return a bound on |force| [N] for inputs in their ranges."""
        twice = 2.0 * bound_energy(self, self.side.max_drive(inputs["speed"]))
        ratio = 1.0 + self.area_ratio
        s_cc = self.compression_m_N + self.mount_m_N * ratio * ratio
        s_cr = -self.mount_m_N * ratio
        s_rr = self.rebound_m_N + self.mount_m_N
        determinant = self.compression_m_N * s_rr + self.rebound_m_N * self.mount_m_N * ratio * ratio
        oil = sqrt(twice * (ratio * ratio * s_rr + 2.0 * ratio * s_cr + s_cc) / determinant)
        rebound = sqrt(twice * s_cc / determinant)
        friction = self.side.friction_N * (1.0 + self.friction_growth_1_N * rebound)
        return (oil + friction + self.side.bound_N(inputs)) * (1.0 + ROUNDING)


def _parse_flow(node: JsonObject) -> IncreasingCurve:
    """Check a flow over its pressure drop; raises ModelError if it does not pass through the origin."""
    curve = parse_curve(node, "drop_N", "flow_m_s")
    if (0.0, 0.0) not in zip(curve.at, curve.values, strict=True):
        raise ModelError(f"{node.where}: no node at drop_N 0 with flow_m_s 0; identify the model again")
    return curve


def _parse_map(node: JsonObject) -> FlowMap:
    """Check the valve's map; raises ModelError if a curve does not pass through the origin."""
    flow = FlowMap.from_json(node, "flow_m_s")
    if 0.0 not in flow.at or any(row[flow.at.index(0.0)] != 0.0 for row in flow.rows):
        raise ModelError(f"{node.where}: no node at flow_m_s 0 with force_N 0 in every list; identify the model again")
    return flow
