"""A damper as a hydraulic network: its numbers, the proof of its force, and the arrays of its tick.

`ces_observer.tick.hydraulic` and `ces_observer.tick.pressures` have the equations. A twin tube has its valve in the
piston, and a base valve with a refill check; a uniflow damper has checks in piston and base, and its valve outside; a
monotube has its valve in the piston, and gas in C_c; a magneto-rheological damper has springs that yield instead of a
valve.

What is proved, for any parameters that a model file can hold and for any inputs:

* A step has one solution: U, the flows and -w, over (r, -1), are gradients of convex functions of (p_c, p_r), strictly
  so for U; w falls as s rises, since each z_j rises with w.
* The network is passive. With Phi the convex function with gradient U, and Phi* its conjugate (the energy stored), at a
  given stroke and setting  Phi*(U(k)) - Phi*(U(k-1)) <= s w - T (dp P + p_c B + p_r E)  by convexity, no flow feeds
  energy, and  M f^2 / 2 + sum_j z_j^2 / (2 k_j)  grows by at most  T d f - s w  for the same reason. What a tick keeps
  of U and z_j is less than all: Phi* and z_j^2, least at 0, only fall by that.
* Pressures are held within +-`most_N`, and the force within its envelope: both stay bounded, whatever the rounding.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain, pairwise
from math import exp, inf
from sys import float_info
from typing import Any, Self

from ces_observer.errors import ModelError
from ces_observer.flat import Layout
from ces_observer.json_text import JsonObject
from ces_observer.proof.certificate import ENERGY_CLAIM, EnergyCertificate
from ces_observer.structures import physical
from ces_observer.structures.curves import MAX_VALUE, Bypass, FlowMap, parse_bypass
from ces_observer.structures.structure import OperatingRange, Ranges, Structure
from ces_observer.tick import edges, mount, pressures
from ces_observer.tick import hydraulic as tick
from ces_observer.tick.pressures import ROUNDING, WARMING_S
from ces_observer.tick.structure import HYDRAULIC
from ces_observer.tick.valve import KEEP

SPREAD = (0.05, 0.2, 0.5, 1.0, 1.7, 3.0, 6.0, 12.0)  # absolute pressures over the reservoir's, between pieces of phi
NEVER_S = 1e6  # a time constant in which nothing relaxes
RELAXATIONS = 7.0  # of relax_s until the past is forgotten: e^-7 = 0.09 % of it is left
KINDS = ("uniflow", "twin tube", "monotube", "magneto-rheological")

OilPiece = tuple[float, float, float]
"""Upper end [N] of a piece of phi, its value at 0 N on the straight line of the piece, and its slope."""


def oil_pieces(reservoir_N: float, air: float) -> list[OilPiece]:
    """Return the pieces of phi; the last has no end."""
    ends = [*(reservoir_N * (time - 1.0) for time in SPREAD), inf]
    shares = [1.0 / SPREAD[0] ** 2, *(1.0 / (a * b) for a, b in pairwise(SPREAD)), 0.0]
    at = [SPREAD[0], *SPREAD]
    return [
        (high, reservoir_N * air * (1.0 - 1.0 / time - share * (time - 1.0)), 1.0 + air * share)
        for high, time, share in zip(ends, at, shares, strict=True)
    ]


METHOD = "every flow and volume rises with its pressure: one solution a step, passive; pressures and force are held"
EDGES = ("piston", "base", "external")
NUMBERS = {  # of a model file, with their limits
    "area_ratio": (0.0, 100.0),
    "compression_m_N": (1e-12, 1.0),
    "rebound_m_N": (1e-12, 1.0),
    "compression_growth_1_m": (-1e3, 1e3),
    "rebound_growth_1_m": (-1e3, 1e3),
    "mount_m_N": (0.0, 1.0),
    "creep_m_Ns": (0.0, 1.0),
    "fade_1_W": (-1.0, 1.0),
    "reservoir_N": (1e-3, MAX_VALUE),
    "air": (0.0, 1e6),
    "most_N": (1.0, MAX_VALUE),
    "bypass_laminar_N": (1e-6, MAX_VALUE),
    "laminar_N": (1e-6, MAX_VALUE),
    "piston_s": (0.0, 1.0),
    "base_s": (0.0, 1.0),
    "external_s": (0.0, 1.0),
    "friction_growth_1_N": (0.0, MAX_VALUE),
    "relax_s": (1e-3, NEVER_S),
    "leak_s": (1e-3, NEVER_S),
}


@dataclass(frozen=True)
class Hydraulic(Structure):
    """A hydraulic network; compliances [m/N] of both chambers, flows as speeds [m/s]; `kind` is one of KINDS."""

    name, keys, option, rank = "hydraulic", ("hydraulic",), "hydraulic", 3
    number, runs = HYDRAULIC, (tick.hydraulic_reset, tick.hydraulic_tick)
    forgets_by_proof = False
    extrapolates, unproved = True, "its force is not proved to be bounded for every input"

    kind: str
    valve: physical.ValvePath
    area_ratio: float
    compression_m_N: float
    rebound_m_N: float
    compression_growth_1_m: float
    rebound_growth_1_m: float
    mount_m_N: float
    creep_m_Ns: float
    fade_1_W: float
    reservoir_N: float
    air: float
    most_N: float
    piston: FlowMap
    base: FlowMap
    external: FlowMap
    bypass: Bypass | None
    bypass_laminar_N: float
    laminar_N: float
    piston_s: float
    base_s: float
    external_s: float
    friction_growth_1_N: float
    relax_s: float
    leak_s: float
    side: physical.SideForces
    reach: float

    @property
    def outside(self) -> str:
        """What becomes of inputs outside the envelope."""
        return f"used as they are up to {self.reach:g} times the envelope, and clamped beyond"

    @property
    def size(self) -> str:
        """The size, in words."""
        counts = {edge: len(getattr(self, edge).rows) for edge in EDGES}
        curves = " and ".join(f"{count} curves of the {edge} valve" for edge, count in counts.items() if count > 1)
        return f"{self.kind}, {curves or 'no valve that the current moves'}{', bypass' if self.bypass else ''}"

    def to_json(self) -> dict[str, Any]:
        """Return the contents of the model file."""
        bypass = {} if self.bypass is None else {"position_m": self.bypass.position_m, "opening": self.bypass.values}
        numbers = {
            "kind": self.kind,
            "valve": self.valve.to_json(),
            **{name: getattr(self, name) for name in NUMBERS},
            **{edge: getattr(self, edge).to_json("flow_m_s") for edge in EDGES},
            "bypass": {name: list(values) for name, values in bypass.items()},
            "side": self.side.to_json(),
            "reach": self.reach,
        }
        return {"hydraulic": numbers}

    @classmethod
    def from_json(cls, root: JsonObject, inputs: Ranges) -> Self:
        """Check the network of a model file; raises ModelError."""
        node = root.at("hydraulic")
        for name in {"relax_s", "leak_s"} - set(node.value):
            raise ModelError(f"{node.where}: '{name}' is missing: the model never forgets; identify it again")
        node.require_only_keys("kind", "valve", *NUMBERS, *EDGES, "bypass", "side", "reach")
        if node.value.get("kind") not in KINDS:
            raise ModelError(f"{node.where}: kind is {node.value.get('kind')!r}; expected one of {', '.join(KINDS)}")
        edges: dict[str, Any] = {edge: _parse_edge(node.at(edge)) for edge in EDGES}
        numbers: dict[str, Any] = {name: node.number(name, *limits) for name, limits in NUMBERS.items()}
        if len({one.at for one in edges.values()}) > 1:
            raise ModelError(f"{node.where}: the edges have different flow_m_s; expected the same for all")
        return cls(
            kind=str(node.value["kind"]),
            valve=physical.ValvePath.from_json(node.at("valve")),
            **numbers,
            **edges,
            bypass=parse_bypass(node.at("bypass")),
            side=physical.SideForces.from_json(node.at("side")),
            reach=node.number("reach", 1.0, physical.MAX_REACH),
        )

    def fill(self, layout: Layout, within: OperatingRange) -> None:
        """Write its numbers into a layout."""
        rate = within.rate_Hz
        layout.reserve(tick.P_HYDRAULIC_END, tick.N_HYDRAULIC_END, tick.S_HYDRAULIC_END, tick.K_HYDRAULIC_END)
        wide = [end for ends in physical.widen(within.inputs, self.reach).values() for end in ends]
        layout.put(tick.WIDE_POSITION_LOW, map(_as_number, wide))
        self.valve.fill(layout, 1.0 / rate)
        self.side.fill(layout, 1.0 / rate)
        layout.p[KEEP] = exp(-1.0 / (rate * self.relax_s))
        self._fill_mount(layout, rate)
        self._fill_edges(layout, rate)
        self._fill_chambers(layout, rate)

    def _fill_chambers(self, layout: Layout, rate_Hz: float) -> None:
        layout.p[pressures.RATIO] = 1.0 + self.area_ratio
        layout.p[pressures.COMPLIANCE_C] = rate_Hz * self.compression_m_N
        layout.p[pressures.COMPLIANCE_R] = rate_Hz * self.rebound_m_N
        layout.p[pressures.GROWTH_C] = self.compression_growth_1_m
        layout.p[pressures.GROWTH_R] = self.rebound_growth_1_m
        layout.p[pressures.SPRING] = self.mount_m_N
        layout.p[pressures.FADE] = self.fade_1_W
        layout.p[pressures.WARMING] = 1.0 / (1.0 + rate_Hz * WARMING_S)
        layout.p[pressures.LAMINAR] = self.laminar_N
        layout.p[pressures.NARROW] = self.bypass_laminar_N
        layout.p[pressures.MAX_PRESSURE] = self.most_N
        layout.p[pressures.FRICTION_GROWTH] = self.friction_growth_1_N
        layout.p[pressures.KEPT_VOLUME] = exp(-1.0 / (rate_Hz * self.leak_s))
        layout.p[pressures.OIL_ENDS] = _as_number(-inf)
        for n, (end, value, slope) in enumerate(oil_pieces(self.reservoir_N, self.air)):
            layout.p[pressures.OIL_ENDS + n + 1] = _as_number(end)
            layout.p[pressures.OIL_VALUES + n] = value
            layout.p[pressures.OIL_SLOPES + n] = slope
        if self.bypass is not None:
            layout.n[pressures.BYPASS_NODES] = len(self.bypass.position_m)
            layout.n[pressures.BYPASS_POSITIONS] = layout.table(self.bypass.position_m)
            layout.n[pressures.BYPASS_LOGARITHMS] = layout.table(self.bypass.logarithms)

    def _fill_edges(self, layout: Layout, rate_Hz: float) -> None:
        lags = (self.piston_s, self.base_s, self.external_s)
        for n, (flow, lag) in enumerate(zip((self.piston, self.base, self.external), lags, strict=True)):
            layout.p[edges.EDGE_SHARE + n] = 1.0 / (1.0 + rate_Hz * lag)
            layout.n[edges.EDGE_NODES + n] = len(flow.at)
            layout.n[edges.LAST_ROW + n] = len(flow.rows) - 1
            layout.n[edges.EDGE_FLOWS + n] = layout.table(flow.at)
            layout.n[edges.EDGE_DROPS + n] = layout.table(chain(*flow.rows))

    def _fill_mount(self, layout: Layout, rate_Hz: float) -> None:
        springs = self.side.friction
        steps = [spring.stiffness_N_m * (1.0 / rate_Hz) for spring in springs]
        yields, moved = ([getattr(spring, name) for spring in springs] for name in ("yield_N", "moved_N"))
        give, held = rate_Hz * self.mount_m_N + self.creep_m_Ns, 0.0
        for step in steps:
            held += step
        layout.p[mount.MOUNT_SPRING] = rate_Hz * self.mount_m_N
        layout.p[mount.MOUNT_GIVE] = give
        layout.p[mount.MOUNT_HELD] = 1.0 / (1.0 + give * held)
        layout.n[mount.SPRINGS] = len(springs)
        layout.n[mount.SPRING_NUMBERS] = layout.table([*steps, *yields, *moved])
        layout.n[mount.SPRING_STATES] = layout.state(4 * len(springs))
        layout.n[mount.SPRING_ORDER] = layout.memory(len(springs))

    def steady_force(self, within: OperatingRange, speed_m_s: float, current_A: float) -> float:
        """Return the force [N] at mid-stroke of full strokes at constant speed and current, here in one long tick."""
        low, high = within.inputs["position"]
        body = self.at_full_strokes(0.5 * (high - low), self.valve.steady(current_A))
        leak = 1.0 / (self.leak_s * physical.LONG_TICK.rate_Hz)  # of the volumes in such a tick, which ends empty
        names = ("compression_m_N", "rebound_m_N")
        run = replace(body, **{name: leak * getattr(body, name) for name in names}).make_predictor(physical.LONG_TICK)
        return run.tick(0.5 * (low + high), speed_m_s, current_A)

    def at_full_strokes(self, half_m: float, setting: float) -> Self:
        """Return the model with the yield forces that its friction has in the middle of strokes to +-`half_m` [m]."""
        elements = (
            physical.FrictionElement(
                one.stiffness_N_m,
                physical.yield_at_mid_stroke(one.stiffness_N_m, one.yield_N + setting * one.moved_N, half_m),
            )
            for one in self.side.friction
        )
        return replace(self, side=replace(self.side, friction=tuple(elements)))

    def certify(self, within: OperatingRange) -> EnergyCertificate:
        """Return the proved bounds on |force| [N]; the force is held within its range, too."""
        most = max(map(abs, within.force_N))
        ranges = within.inputs, physical.widen(within.inputs, self.reach)
        envelope, any_input = (min(self.bound_force(inputs), most) for inputs in ranges)
        slowest = max(self.relax_s, self.leak_s if self.leak_s < NEVER_S else 0.0)
        return EnergyCertificate(envelope, any_input, ENERGY_CLAIM, METHOD, RELAXATIONS * slowest)

    def bound_force(self, inputs: Ranges) -> float:
        """Return a bound on |force| [N] for inputs in their ranges."""
        oil = (2.0 + self.area_ratio) * self.most_N
        friction = self.side.friction_N * (1.0 + self.friction_growth_1_N * self.most_N)
        return (oil + friction + self.side.bound_N(inputs)) * (1.0 + ROUNDING)


def _as_number(end: float) -> float:
    """Return the end of a range, the largest number instead of infinity."""
    return min(max(end, -float_info.max), float_info.max)


def _parse_edge(node: JsonObject) -> FlowMap:
    """Check an edge's map; raises ModelError if a curve does not pass through the origin."""
    flow = FlowMap.from_json(node, "flow_m_s")
    if 0.0 not in flow.at or any(row[flow.at.index(0.0)] != 0.0 for row in flow.rows):
        raise ModelError(f"{node.where}: no node at flow_m_s 0 with force_N 0 in every list; identify the model again")
    return flow
