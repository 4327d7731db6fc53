"""A damper's two chambers (thesis fig. 2.3): pressures that build up in elastic oil, and flows between them.

With pressures p_c, p_r above the reservoir's, as forces [N] on the rod side's area, and flows as speeds [m/s] of it:

    s       = (1 + ratio) p_c - p_r                                        force of the oil
    drive   = (1 + ratio) drive(k), -drive(k)                              into compression and rebound chamber
    C_c dp_c/dt + (1 + ratio) M ds/dt = (1 + ratio) drive - check(p_c - p_r) + refill(-p_c)
    C_r dp_r/dt - M ds/dt             = -drive + check(p_c - p_r) - valve(p_r, setting)
    force(k) = s(k) + side force(k),  the friction elements times 1 + growth max(p_r, 0)

M is the compliance [m/N] of mounts in series. Implicit Euler steps; check, refill and valve are increasing, piecewise
linear curves (the valve's as the inverse of its map of force over flow). So with P = (p_c, p_r), a = (1 + ratio, -1), S
= diag(C_c, C_r) + M a a' and L the flows,  S (P(k) - P(k-1)) + T L(P(k)) = T a drive(k).  S is positive definite and L
the gradient of a convex function: a step minimises a convex function and has one solution. Between two runs with the
same inputs and settings, dP' (L(P) - L(Q)) >= 0, so that their difference dP never grows in the norm of S. The energy
1/2 P' S P grows only where P' L(P) < drive a' P, which bounds it.

A step adds at most T (drive a' P - P' L(P)) to the energy 1/2 P' S P, with P the pressures after it. So the energy
grows only into the set P' L(P) <= fastest |a' P|, and no run from rest exceeds its largest energy there.

The free run solves each step exactly. With a = (r, -1), r = 1 + ratio, a step solves (S / T) (P - P(k-1)) = a drive -
L(P). On given pieces of the curves the flows L are straight lines with slopes `across` (check valve), `sucked` (refill)
and `through` (valve). The change of P follows from their values at P(k-1), here with all sums arranged so that none
cancels:

    det   = (C_c + sucked) (C_r + M + across + through) + (r^2 M + across) (C_r + through) + M across ratio^2
    x, y  = M (ratio check + refill - r valve),  across (ratio drive + refill - valve)
    det dp_c = (C_r + through) (r drive - check + refill) + x + y
    det dp_r = (C_c + sucked) (check - drive - valve) + r x + y

with C_c, C_r and M divided by T. A step starts on the pieces of the last one and follows the solutions from piece to
piece (Newton's method), which mostly ends at once; if not, it searches p_r in a bracket that halves.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from heapq import heapify, heappop, heappush
from itertools import pairwise
from math import cos, inf, nan, pi, sin, sqrt
from typing import Any, ClassVar, Self

from ces_observer.errors import ModelError
from ces_observer.json_text import JsonObject
from ces_observer.structures.curves import FlowMap, IncreasingCurve, parse_curve, parse_growth, pieces
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
from ces_observer.structures.structure import OperatingRange, Range, Ranges, hold

MAX_PRESSURE_N = 1e12
COARSE, FINE = 64, 8192  # intervals of directions (p_c, p_r) in a turn: at the start, and where the bound is found
MAX_HALVINGS = 1000
ROUNDING = 1e-9  # relative, far above what the bound's arithmetic loses


def bound_energy(model: Chambers, fastest: float) -> float:
    """Return a bound on 1/2 P' S P over all P with P' L(P) <= fastest |a' P|: no run from rest has more energy.

    Along a ray P = t d, d' L(t d) rises with t, so the set ends at one t. For each interval of directions that t is
    bounded with the least dissipation and the largest drive of the interval, over all settings of the valve; the
    interval with the most energy is halved until it is narrow (best first), so that the bound is tight.
    """
    flows = _Flows(model)
    queue = [(-flows.bound_energy(k, COARSE, fastest), k, COARSE) for k in range(COARSE)]
    heapify(queue)
    for _ in range(MAX_HALVINGS):
        if queue[0][2] >= FINE:
            break
        _, k, count = heappop(queue)
        for half in (2 * k, 2 * k + 1):
            heappush(queue, (-flows.bound_energy(half, 2 * count, fastest), half, 2 * count))
    return -queue[0][0] * (1.0 + ROUNDING)


class _Flows:
    """Bounds over intervals of directions d: the k-th of `count`, and for every setting of the valve."""

    def __init__(self, model: Chambers) -> None:
        self._model = model
        self._ratio = 1.0 + model.area_ratio
        self._check, self._refill = model.check, model.refill
        self._valves = model.map.inverses

    def bound_energy(self, k: int, count: int, fastest: float) -> float:
        """Return a bound on the energy of all P of the interval with P' L(P) <= fastest |a' P|."""
        model, d_c, d_r = self._model, _range(cos, k, count), _range(sin, k, count)
        force = self._largest_force(d_c, d_r)
        end = self._reach(d_c, d_r, fastest * force)
        c, r = max(map(abs, d_c)), max(map(abs, d_r))
        stored = model.compression_m_N * c * c + model.rebound_m_N * r * r + model.mount_m_N * force * force
        return 0.5 * stored * end * end

    def _largest_force(self, d_c: Range, d_r: Range) -> float:
        """Return the largest |a' d| of the directions."""
        ends = self._ratio * d_c[0] - d_r[1], self._ratio * d_c[1] - d_r[0]
        return max(map(abs, ends)) * (1.0 + ROUNDING)

    def _reach(self, d_c: Range, d_r: Range, driven: float) -> float:
        """Return a length t [N] from which on every direction dissipates more than `driven`; infinite if none."""
        high = 1.0
        while self._dissipated(d_c, d_r, high) <= driven:
            high *= 2.0
            if high > MAX_PRESSURE_N:
                return inf
        low = 0.0 if high == 1.0 else 0.5 * high
        while high - low > 1e-4 * high:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self._dissipated(d_c, d_r, middle) > driven else (middle, high)
        return high

    def _dissipated(self, d_c: Range, d_r: Range, t: float) -> float:
        total = _least(self._check, (d_c[0] - d_r[1], d_c[1] - d_r[0]), t)
        total += _least(self._refill, (-d_c[1], -d_c[0]), t)
        return total + min(_least(valve, d_r, t) for valve in self._valves)


def _range(function: Callable[[float], float], k: int, count: int) -> Range:
    """Return the range of cos or sin over the k-th of `count` angles of a turn, none of which crosses a quarter."""
    ends = [function(2.0 * pi * n / count) for n in (k, k + 1)]
    return min(ends) - 1e-12, max(ends) + 1e-12


def _least(curve: IncreasingCurve, d: Range, t: float) -> float:
    """Return the least d curve(t d) over the interval; a curve through the origin has its least nearest to it."""
    if d[0] < 0.0 < d[1]:
        return 0.0
    return min(end * curve(t * end) for end in d)


QUICK_STEPS = 3  # from pieces to pieces, before the search
MAX_STEPS = 300  # of the search: each leaves a piece for good, or halves the bracket
CLOSE = 1e-12  # relative change of the pressures that ends a step

ValvePiece = tuple[float, float, float, float, float, float]
"""Flow and width [m/s] of a piece, force [N] at its left node and rise to the right one, and how far the next row's
differ from them."""


class ChambersRun:
    """The free run of a model with chambers; `clamped`, `held`: the last inputs, force were outside the envelope."""

    def __init__(self, model: Chambers, within: OperatingRange) -> None:
        rate = within.rate_Hz
        self._inputs = InputLimiter(within, model.reach)
        self._valve = ValveRun(model.valve, 1.0 / rate)
        self._side = SideRun(model.side, 1.0 / rate)
        self._rubs, self._growth = bool(model.side.friction), model.friction_growth_1_N
        self._drops, self._checks = model.check.at[1:-1], pieces(model.check.at, model.check.values)
        self._suctions, self._refills = model.refill.at[1:-1], pieces(model.refill.at, model.refill.values)
        rows = model.map.rows
        self._top = len(rows) - 1
        self._rows = [_blend(model.map.at, *pair) for pair in pairwise((*rows, rows[-1]))]
        self._ratio = 1.0 + model.area_ratio
        self._stored = tuple(rate * one for one in (model.compression_m_N, model.rebound_m_N, model.mount_m_N))
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
        self.pressures = 0.0, 0.0
        self._pieces = 0, 0, 0
        self._inputs.outside = self.held = False

    def tick(self, position: float, speed: float, current: float) -> float:
        """Return the force [N] at this tick, held in its envelope; infinite if it is not finite."""
        position, speed, current = self._inputs.limit(position, speed, current)
        drive, force = self._side.tick(position, speed)
        p_c, p_r = self.advance(drive, self._valve.tick(current))
        force += self._ratio * p_c - p_r
        if self._rubs:
            force += self._side.friction(drive) * (1.0 + self._growth * p_r if p_r > 0.0 else 1.0)
        low, high = self._limits
        self.held = not low <= force <= high
        return hold(force, low, high) if self.held else force

    def advance(self, drive: float, setting: float) -> tuple[float, float]:
        """Step both pressures [N] at a drive [m/s] and a setting of the valve."""
        share = setting * self._top
        row = int(share)
        share -= row
        valves = self._rows[row]
        i, j, k = self._pieces
        for _ in range(QUICK_STEPS):
            p_c, p_r, left, right = self._solve(i, j, valves[k], share, drive)
            before = i, j, k
            i, j = bisect_left(self._drops, p_c - p_r), bisect_left(self._suctions, -p_c)
            if not left < p_r <= right:
                k = _pick(valves, share, p_r)
            if before == (i, j, k):
                break
        else:
            p_c, p_r = self._search(valves, share, drive)
        self._pieces = i, j, k
        self.pressures = p_c, p_r
        return p_c, p_r

    def _search(self, valves: Sequence[ValvePiece], share: float, drive: float) -> tuple[float, float]:
        """Solve the step by Newton's method for p_r, with the p_c that belongs to it, in a bracket that halves."""
        low, high, p_r = -inf, inf, self.pressures[1]
        for _ in range(MAX_STEPS):
            p_c = self._balance(p_r, drive)
            i, j = bisect_left(self._drops, p_c - p_r), bisect_left(self._suctions, -p_c)
            p_c, new, *_ = self._solve(i, j, valves[_pick(valves, share, p_r)], share, drive)
            if abs(new - p_r) <= CLOSE * (1.0 + abs(new)):
                return p_c, new
            low, high = (p_r, high) if new > p_r else (low, p_r)
            p_r = new if low < new < high else 0.5 * (low + high)
        return nan, nan  # no force rather than a wrong one

    def _balance(self, p_r: float, drive: float) -> float:
        """Return the p_c [N] at which the flows into the compression chamber balance, for a given p_r [N]."""
        (c_c, _, mount), r, (old_c, old_r) = self._stored, self._ratio, self.pressures
        stored, pushed = c_c + r * r * mount, r * mount * (p_r - old_r) + r * drive
        low, high, p_c = -inf, inf, old_c
        for _ in range(MAX_STEPS):
            at, check, across = self._checks[bisect_left(self._drops, p_c - p_r)]
            check += across * (p_c - p_r - at)
            at, refill, sucked = self._refills[bisect_left(self._suctions, -p_c)]
            refill -= sucked * (p_c + at)
            missing = stored * (p_c - old_c) - pushed + check - refill
            before, p_c = p_c, p_c - missing / (stored + across + sucked)
            if abs(p_c - before) <= CLOSE * (1.0 + abs(p_c)):
                break
            low, high = (before, high) if p_c > before else (low, before)
            p_c = p_c if low < p_c < high else 0.5 * (low + high)
        return p_c

    def _solve(
        self, i: int, j: int, valve: ValvePiece, share: float, drive: float
    ) -> tuple[float, float, float, float]:
        """Return both pressures [N] after a step on these pieces, and the ends [N] of the valve's piece."""
        old_c, old_r = self.pressures
        c_c, c_r, mount = self._stored
        at, flow, across = self._checks[i]
        check = flow + across * (old_c - old_r - at)
        at, flow, sucked = self._refills[j]
        refill = flow - sucked * (old_c + at)
        flow, width, left, rise, higher, steeper = valve
        left += share * higher
        rise += share * steeper
        through = width / rise
        valved = flow + through * (old_r - left)
        c_c += sucked
        c_r += through
        r = self._ratio
        x = mount * ((r - 1.0) * check + refill - r * valved)
        y = across * ((r - 1.0) * drive + refill - valved)
        det = c_c * (c_r + mount + across) + (r * r * mount + across) * c_r + mount * across * (r - 1.0) ** 2
        return (
            old_c + (c_r * (r * drive - check + refill) + x + y) / det,
            old_r + (c_c * (check - drive - valved) + r * x + y) / det,
            left,
            left + rise,
        )


def _blend(at: Sequence[float], below: Sequence[float], above: Sequence[float]) -> list[ValvePiece]:
    """Return the pieces of the curves between two rows of the valve's map."""
    return [
        (x0, x1 - x0, a0, a1 - a0, b0 - a0, (b1 - b0) - (a1 - a0))
        for (x0, x1), (a0, a1), (b0, b1) in zip(pairwise(at), pairwise(below), pairwise(above), strict=True)
    ]


def _pick(valves: Sequence[ValvePiece], share: float, at: float) -> int:
    """Return the index of the piece that holds the force `at` [N] of a curve between two rows."""
    return bisect_left(valves, at, 1, key=lambda piece: piece[2] + share * piece[4]) - 1


METHOD = "all flows rise with their pressure drop; energy bounded over all directions of (p_c, p_r), best first"


@dataclass(frozen=True)
class Chambers(PhysicalStructure):
    """A damper with two chambers; compliances [m/N] of both chambers and of the mounts, flows as speeds [m/s]."""

    name: ClassVar[str] = "chambers"
    keys: ClassVar[tuple[str, ...]] = ("chambers",)
    option: ClassVar[str] = "chambers"
    rank: ClassVar[int] = 4
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
