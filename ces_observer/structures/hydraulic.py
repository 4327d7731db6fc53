"""A damper as a hydraulic network: two chambers and a reservoir, joined by three edges whose flows rise with the drop.

Edges: P from compression to rebound chamber (piston), B from compression chamber to reservoir (base valve), E from
rebound chamber to reservoir (external valve). With pressures p_c, p_r above the reservoir's, as forces [N] on the rod
side's area, flows as speeds [m/s] of it, r = 1 + area ratio, s = r p_c - p_r, T the tick, d the drive, x the stroke:

    U_c(k) - U_c(k-1) = r w + T [ -P - B ],   U_c = C_c e^(g_c x) phi(p_c)
    U_r(k) - U_r(k-1) =  -w + T [  P - E ],   U_r = C_r e^(g_r x) phi(p_r)
    w = T d - M (f(k) - f(k-1)) - T creep f(k),   f = s + sum_j z_j,   z_j(k) = clip(z_j(k-1) + k_j w, -+yield_j)
    P = h (b q_P(dp) + (1 - b) y(k-1) root(dp) + A(x - M f(k-1)) passage(dp)),  dp = p_c - p_r,  b = T / (lag + T),
        y(k) = (1 - b) y(k-1) + b q_P(dp) / root(dp),  root(z) = z / sqrt(|z| + e),
        passage(z) = 2 z / (sqrt(n + 4 |z|) + sqrt(n));  likewise B with p_c and E with p_r, without A
    h = e^(fade heat(k-1)),  heat a low-pass of 100 s of |f d|
    force(k) = f + side force(k),  the friction elements z_j times 1 + growth max(p_r, 0)

U are the volumes stored, C the compliances of the chambers' oil, which change with their length, and M that of mounts
in series, which may creep; w is the way behind them, and z_j are springs that yield there: friction, and a fluid that
the current stiffens. phi is that of oil with air: with R the reservoir's absolute pressure, phi' = 1 + air (R / (p +
R))^2, as straight pieces that meet at R times SPREAD; below the first it stays as soft, a void that must be refilled.
q_P, q_B(p_c) and q_E(p_r) are piecewise linear, increasing, through the origin; those that the current moves are
blended between rows. A valve's opening y follows its steady flow with a lag: a check that closes late passes oil back.
A >= 0 is a bypass that depends on the stroke behind the mount, such as a groove: a laminar and a turbulent resistance
in series. Oil that warms is thinner: all flows grow by h, which is held within e^(-2) and e^2.

A twin tube has its valve in the piston, and a base valve with a refill check; a uniflow damper has checks in piston and
base, and its valve outside; a monotube has its valve in the piston, and gas in C_c; a magneto-rheological damper has
springs that yield instead of a valve.

What is proved, for any parameters that a model file can hold and for any inputs:

* A step has one solution: U, the flows and -w, over (r, -1), are gradients of convex functions of (p_c, p_r), strictly
  so for U; w falls as s rises, since each z_j rises with w.
* The network is passive. With Phi the convex function with gradient U, and Phi* its conjugate (the energy stored), at a
  given stroke and setting  Phi*(U(k)) - Phi*(U(k-1)) <= s w - T (dp P + p_c B + p_r E)  by convexity, no flow feeds
  energy, and  M f^2 / 2 + sum_j z_j^2 / (2 k_j)  grows by at most  T d f - s w  for the same reason.
* Pressures are held within +-`most_N`, and the force within its envelope: both stay bounded, whatever the rounding.

A tick solves the step on the pieces of the last one and goes on from piece to piece (Newton's method). Steps along
which the convex function would rise again are halved.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from math import exp, inf, nan, sqrt
from typing import Any, ClassVar, Self

from ces_observer.errors import ModelError
from ces_observer.json_text import JsonObject
from ces_observer.structures.curves import (
    MAX_VALUE,
    Bypass,
    EdgeRun,
    FlowMap,
    line_of,
    parse_bypass,
)
from ces_observer.structures.mount import MountRun
from ces_observer.structures.physical import (
    MAX_REACH,
    FrictionElement,
    InputLimiter,
    PhysicalStructure,
    SideForces,
    SideRun,
    ValvePath,
    ValveRun,
    yield_at_mid_stroke,
)
from ces_observer.structures.structure import OperatingRange, Ranges, hold

SPREAD = (0.05, 0.2, 0.5, 1.0, 1.7, 3.0, 6.0, 12.0)  # absolute pressures over the reservoir's, between pieces of phi
WARMING_S = 100.0  # in which a damper takes up its heat
WARMEST = 2.0  # growth of its flows, as a logarithm
MAX_STEPS = 300  # Newton steps and halvings of a tick
CLOSE = 1e-12  # relative change of the pressures that ends a step,
NEAR = 1e-6  # and of a Newton step that squares its error
TURN = 0.1  # share of the slope along a step, reversed, from which the step is halved,
PATIENCE = 20  # for this many steps; then none may turn
ROUNDING = 1e-9  # relative
STILL_N = 1e-6  # drops below may be rounding, whose sign says nothing: an opening stays as it is
KINDS = ("uniflow", "twin tube", "monotube", "magneto-rheological")

OilPiece = tuple[float, float, float, float]
"""Ends [N] of a piece of phi, its value at 0 N on the straight line of the piece, and its slope."""


def oil_pieces(reservoir_N: float, air: float) -> list[OilPiece]:
    """Return the pieces of phi."""
    ends = [-inf, *(reservoir_N * (time - 1.0) for time in SPREAD), inf]
    shares = [1.0 / SPREAD[0] ** 2, *(1.0 / (a * b) for a, b in pairwise(SPREAD)), 0.0]
    at = [SPREAD[0], *SPREAD]
    return [
        (low, high, reservoir_N * air * (1.0 - 1.0 / time - share * (time - 1.0)), 1.0 + air * share)
        for low, high, time, share in zip(ends, ends[1:], at, shares, strict=False)
    ]


class HydraulicRun:
    """The free run of a network; `clamped`, `held`: the last inputs, force were outside the envelope."""

    def __init__(self, model: Hydraulic, within: OperatingRange) -> None:
        rate = within.rate_Hz
        self._inputs = InputLimiter(within, model.reach)
        self._valve = ValveRun(model.valve, 1.0 / rate)
        self._side = SideRun(model.side, 1.0 / rate)
        self.mount = MountRun(model.side.friction, rate * model.mount_m_N, model.creep_m_Ns, 1.0 / rate)
        self._friction_growth = model.friction_growth_1_N
        self._edges = EdgeRun(model.piston), EdgeRun(model.base), EdgeRun(model.external)
        self._bypass, self._narrow, self._spring = model.bypass, model.bypass_laminar_N, model.mount_m_N
        self._small = model.laminar_N
        self._fade, self._warming = model.fade_1_W, 1.0 / (1.0 + rate * WARMING_S)
        self._ratio = 1.0 + model.area_ratio
        self._stored = rate * model.compression_m_N, rate * model.rebound_m_N
        self._growth = model.compression_growth_1_m, model.rebound_growth_1_m
        self._oil, self._most = oil_pieces(model.reservoir_N, model.air), model.most_N
        self._shares = tuple(1.0 / (1.0 + rate * lag) for lag in (model.piston_s, model.base_s, model.external_s))
        self._limits = within.force_N
        self.reset()

    @property
    def clamped(self) -> bool:
        """True if the last inputs lay outside the envelope."""
        return self._inputs.outside

    def reset(self) -> None:
        """Forget the past: chambers at the reservoir's pressure."""
        self._valve.reset()
        self._side.reset()
        self.mount.reset()
        self.pressures = 0.0, 0.0
        self.heat = 0.0
        self._volumes: tuple[float, float] | None = None
        self._openings = 0.0, 0.0, 0.0
        middle = tuple((len(edge.flows) - 1) // 2 for edge in self._edges)
        self._pieces = *middle, self._find_oil(0.0), self._find_oil(0.0)
        self._inputs.outside = self.held = False

    def tick(self, position: float, speed: float, current: float) -> float:
        """Return the force [N] at this tick, held in its envelope; infinite if it is not finite."""
        position, speed, current = self._inputs.limit(position, speed, current)
        drive, force = self._side.tick(position, speed)
        setting = self._valve.tick(current)
        p_c, p_r = self.advance(position, drive, setting)
        growth = self._friction_growth * p_r if p_r > 0.0 else 0.0
        force += self._ratio * p_c - p_r + self.mount.rubbed * (1.0 + growth)
        low, high = self._limits
        self.held = not low <= force <= high
        return hold(force, low, high) if self.held else force

    def advance(self, position: float, drive: float, setting: float) -> tuple[float, float]:  # noqa: PLR0912, PLR0915
        """Step both pressures [N] at a position [m], a drive [m/s] and a setting of the valve."""
        c_c, c_r = self._stored
        by_c, by_r = self._growth
        c_c, c_r, r, oil = c_c * exp(by_c * position), c_r * exp(by_r * position), self._ratio, self._oil
        thick = exp(-min(max(self._fade * self.heat, -WARMEST), WARMEST))  # it divides volumes instead of flows
        (p_c, p_r), (i, j, m, n, o) = self.pressures, self._pieces
        if self._volumes is None:
            _, _, phi, _ = oil[n]
            self._volumes = c_c * phi, c_r * phi
        u_c, u_r = self._volumes
        u_c, u_r, c_c, c_r = thick * u_c, thick * u_r, thick * c_c, thick * c_r
        behind = self.mount
        give, free = behind.give, behind.begin(drive, setting)
        shift, share, low, high = behind.find(left := free - give * (r * p_c - p_r))
        small, (y_p, y_b, y_e), (b_p, b_b, b_e) = self._small, self._openings, self._shares
        o_p, o_b, o_e = (1.0 - b_p) * y_p, (1.0 - b_b) * y_b, (1.0 - b_e) * y_e
        bypassed, narrow, rooted = 0.0, self._narrow, sqrt(self._narrow)
        if self._bypass:
            bypassed = self._bypass(position - self._spring * behind.pull)
        piston, base, external = self._edges
        (across, x), (below, y), (beyond, z) = piston.blend(setting), base.blend(setting), external.blend(setting)
        at_p, s_p, p_low, p_high = line_of(across[i], x, b_p)
        at_b, s_b, b_low, b_high = line_of(below[j], y, b_b)
        at_e, s_e, e_low, e_high = line_of(beyond[m], z, b_e)
        d_c = d_r = fall = 0.0
        for step in range(MAX_STEPS):
            drop = p_c - p_r
            size = abs(drop) + small
            root = sqrt(size)
            passed = at_p + s_p * drop + o_p * drop / root
            p_q = s_p + o_p * (0.5 * abs(drop) + small) / (size * root)
            if bypassed:
                root = sqrt(narrow + 4.0 * abs(drop))
                passed += 2.0 * bypassed * drop / (root + rooted)
                p_q += bypassed / root
            size = abs(p_c) + small
            root = sqrt(size)
            based = at_b + s_b * p_c + o_b * p_c / root
            b_q = s_b + o_b * (0.5 * abs(p_c) + small) / (size * root)
            size = abs(p_r) + small
            root = sqrt(size)
            outer = at_e + s_e * p_r + o_e * p_r / root
            e_q = s_e + o_e * (0.5 * abs(p_r) + small) / (size * root)
            c_low, c_high, phi_c, soft_c = oil[n]
            r_low, r_high, phi_r, soft_r = oil[o]
            way = thick * share * (left + shift)
            f_c = u_c - c_c * (phi_c + soft_c * p_c) + r * way - passed - based
            f_r = u_r - c_r * (phi_r + soft_r * p_r) - way + passed - outer
            if step and f_c * d_c + f_r * d_r < -(TURN if step < PATIENCE else ROUNDING) * fall:
                d_c, d_r, same = 0.5 * d_c, 0.5 * d_r, False
                p_c, p_r = p_c - d_c, p_r - d_r
            else:
                mount = thick * give * share
                own_c, own_r, both = c_c * soft_c + b_q, c_r * soft_r + e_q, p_q + r * mount
                a_c, a_r = own_c + p_q + r * r * mount, own_r + p_q + mount
                determinant = own_c * a_r + own_r * (p_q + r * r * mount) + p_q * mount * (r - 1.0) * (r - 1.0)
                d_c, d_r = (a_r * f_c + both * f_r) / determinant, (both * f_c + a_c * f_r) / determinant
                fall = f_c * d_c + f_r * d_r
                p_c, p_r, same = p_c + d_c, p_r + d_r, True
            drop = p_c - p_r
            if not p_low < drop <= p_high:
                same &= i == (i := piston.find(across, x, drop, i))
                at_p, s_p, p_low, p_high = line_of(across[i], x, b_p)
            if not b_low < p_c <= b_high:
                same &= j == (j := base.find(below, y, p_c, j))
                at_b, s_b, b_low, b_high = line_of(below[j], y, b_b)
            if not e_low < p_r <= e_high:
                same &= m == (m := external.find(beyond, z, p_r, m))
                at_e, s_e, e_low, e_high = line_of(beyond[m], z, b_e)
            if not c_low < p_c <= c_high:
                same, n = False, self._find_oil(p_c)
            if not r_low < p_r <= r_high:
                same, o = False, self._find_oil(p_r)
            left = free - give * (r * p_c - p_r)
            if not low <= share * (left + shift) <= high:
                before, (shift, share, low, high) = (shift, share), behind.find(left)
                same &= before == (shift, share)
            close = NEAR if same else CLOSE
            if abs(d_c) <= close * (1.0 + abs(p_c)) and abs(d_r) <= close * (1.0 + abs(p_r)):
                break
        else:
            self.pressures = nan, nan  # no force rather than a wrong one
            return self.pressures
        most = self._most
        if not (-most <= p_c <= most and -most <= p_r <= most):
            p_c, p_r = min(max(p_c, -most), most), min(max(p_r, -most), most)
            n, o = self._find_oil(p_c), self._find_oil(p_r)
            i = piston.find(across, x, p_c - p_r, i)
            j, m = base.find(below, y, p_c, j), external.find(beyond, z, p_r, m)
            at_p, s_p, _, _ = line_of(across[i], x, b_p)
            at_b, s_b, _, _ = line_of(below[j], y, b_b)
            at_e, s_e, _, _ = line_of(beyond[m], z, b_e)
            left = free - give * (r * p_c - p_r)
            shift, share, _, _ = behind.find(left)
        _, _, phi_c, soft_c = oil[n]
        _, _, phi_r, soft_r = oil[o]
        self._volumes = c_c / thick * (phi_c + soft_c * p_c), c_r / thick * (phi_r + soft_r * p_r)
        behind.end(share * (left + shift), r * p_c - p_r)
        self.heat += self._warming * (abs(behind.pull * drive) - self.heat)
        drop = p_c - p_r  # below STILL_N, openings stay as they are
        self._openings = (
            y_p if -STILL_N < drop < STILL_N else o_p + (at_p + s_p * drop) * sqrt(abs(drop) + small) / drop,
            y_b if -STILL_N < p_c < STILL_N else o_b + (at_b + s_b * p_c) * sqrt(abs(p_c) + small) / p_c,
            y_e if -STILL_N < p_r < STILL_N else o_e + (at_e + s_e * p_r) * sqrt(abs(p_r) + small) / p_r,
        )
        self._pieces, self.pressures = (i, j, m, n, o), (p_c, p_r)
        return p_c, p_r

    def _find_oil(self, pressure: float) -> int:
        """Return the piece of phi that holds a pressure [N]."""
        return next((n for n, (_, high, *_) in enumerate(self._oil) if pressure <= high), 0)  # the first for no number


METHOD = "every flow and volume rises with its pressure: one solution a step, passive; pressures and force are held"
EDGES = ("piston", "base", "external")
NUMBERS = {  # of a model file, with their limits
    "area_ratio": (0.0, 100.0),
    "compression_m_N": (1e-12, 1.0),
    "rebound_m_N": (1e-12, 1.0),
    "compression_growth_1_m": (-100.0, 100.0),
    "rebound_growth_1_m": (-100.0, 100.0),
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
}


@dataclass(frozen=True)
class Hydraulic(PhysicalStructure):
    """A hydraulic network; compliances [m/N] of both chambers, flows as speeds [m/s]; `kind` is one of KINDS."""

    name: ClassVar[str] = "hydraulic"
    keys: ClassVar[tuple[str, ...]] = ("hydraulic",)
    option: ClassVar[str] = "hydraulic"
    rank: ClassVar[int] = 3
    method: ClassVar[str] = METHOD

    kind: str
    valve: ValvePath
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
    side: SideForces
    reach: float

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
        node.require_only_keys("kind", "valve", *NUMBERS, *EDGES, "bypass", "side", "reach")
        if node.value.get("kind") not in KINDS:
            raise ModelError(f"{node.where}: kind is {node.value.get('kind')!r}; expected one of {', '.join(KINDS)}")
        edges: dict[str, Any] = {edge: _parse_edge(node.at(edge)) for edge in EDGES}
        numbers: dict[str, Any] = {name: node.number(name, *limits) for name, limits in NUMBERS.items()}
        if len({one.at for one in edges.values()}) > 1:
            raise ModelError(f"{node.where}: the edges have different flow_m_s; expected the same for all")
        return cls(
            kind=str(node.value["kind"]),
            valve=ValvePath.from_json(node.at("valve")),
            **numbers,
            **edges,
            bypass=parse_bypass(node.at("bypass")),
            side=SideForces.from_json(node.at("side")),
            reach=node.number("reach", 1.0, MAX_REACH),
        )

    def make_predictor(self, within: OperatingRange) -> HydraulicRun:
        """Return a new free run."""
        return HydraulicRun(self, within)

    def at_full_strokes(self, half_m: float, setting: float) -> Self:
        """Return the model with the yield forces that its friction has in the middle of strokes to +-`half_m` [m]."""
        elements = (
            FrictionElement(
                one.stiffness_N_m,
                yield_at_mid_stroke(one.stiffness_N_m, one.yield_N + setting * one.moved_N, half_m),
            )
            for one in self.side.friction
        )
        return replace(self, side=replace(self.side, friction=tuple(elements)))

    def bound_force(self, inputs: Ranges) -> float:
        """Return a bound on |force| [N] for inputs in their ranges."""
        oil = (2.0 + self.area_ratio) * self.most_N
        friction = self.side.friction_N * (1.0 + self.friction_growth_1_N * self.most_N)
        return (oil + friction + self.side.bound_N(inputs)) * (1.0 + ROUNDING)


def _parse_edge(node: JsonObject) -> FlowMap:
    """Check an edge's map; raises ModelError if a curve does not pass through the origin."""
    flow = FlowMap.from_json(node, "flow_m_s")
    if 0.0 not in flow.at or any(row[flow.at.index(0.0)] != 0.0 for row in flow.rows):
        raise ModelError(f"{node.where}: no node at flow_m_s 0 with force_N 0 in every list; identify the model again")
    return flow
