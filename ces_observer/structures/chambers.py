"""A damper's two chambers (thesis fig. 2.3): pressures that build up in elastic oil, and flows between them.

With pressures p_c, p_r above the reservoir's, as forces [N] on the rod side's area, and flows as speeds [m/s] of it:

    s       = (1 + ratio) p_c - p_r                                        force of the oil
    drive   = (1 + ratio) drive(k), -drive(k)                              into compression and rebound chamber
    C_c dp_c/dt + (1 + ratio) M ds/dt = (1 + ratio) drive - check(p_c - p_r) + refill(-p_c)
    C_r dp_r/dt - M ds/dt             = -drive + check(p_c - p_r) - valve(p_r, setting)
    force(k) = s(k) + side force(k),  the friction elements times 1 + growth max(p_r, 0)

M is the compliance [m/N] of mounts in series. Implicit Euler steps; check, refill and valve are increasing, piecewise
linear curves (the valve's as the inverse of its map of force over flow). So with P = (p_c, p_r), a = (1 + ratio, -1),
S = diag(C_c, C_r) + M a a' and L the flows,  S (P(k) - P(k-1)) + T L(P(k)) = T a drive(k):  S is positive definite and L
the gradient of a convex function. A step minimises a convex function; it has one solution, and the difference of two
runs with the same inputs never grows in the norm of S. The energy 1/2 P' S P grows only where P' L(P) < drive a' P,
which bounds it: `bound_energy`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, inf, pi, sin, sqrt
from typing import Any, ClassVar, Self

from ces_observer.errors import ModelError
from ces_observer.json_checks import JsonObject
from ces_observer.proof.energy import EnergyCertificate
from ces_observer.structures.flow_map import FlowMap, parse_growth
from ces_observer.structures.increasing_curves import IncreasingCurve, parse_curve, segments
from ces_observer.structures.reach import MAX_REACH, InputLimiter, widen
from ces_observer.structures.side_forces import SideForces, SideRun, pick_segment
from ces_observer.structures.structure import OperatingRange, Range, Ranges, Structure
from ces_observer.structures.valve_path import ValvePath, ValveRun

QUICK_STEPS = 8  # Newton steps from piece to piece, before steps with a line search
MAX_STEPS = 400  # of these
MAX_PRESSURE_N = 1e12
CLOSE = 1e-12  # relative change of the pressures that ends a step
DIRECTIONS = 360  # of (p_c, p_r), each an interval of angles, over which the energy is bounded
STILL = OperatingRange(1e-6, dict.fromkeys(("position", "speed", "current"), (-inf, inf)), (-inf, inf))
ROUNDING = 1e-9  # relative, far above what the bound's arithmetic loses
CLAIM = "the energy of the difference of two runs with the same inputs never grows; |F| stays bounded for every input"
METHOD = "all flows rise with their pressure drop; energy bounded along {} intervals of directions of (p_c, p_r)"


@dataclass(frozen=True)
class Chambers(Structure):
    """A damper with two chambers; compliances [m/N] of both chambers and of the mounts, flows as speeds [m/s]."""

    name: ClassVar[str] = "chambers"
    keys: ClassVar[tuple[str, ...]] = ("chambers",)
    extrapolates: ClassVar[bool] = True

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
    def max_lag(self) -> int:
        """Longest lag of any signal in ticks."""
        return self.valve.max_lag

    @property
    def size(self) -> str:
        """The size, in words."""
        return f"2 chambers, {len(self.map.rows)} valve curves of {len(self.map.at)} nodes"

    def steady_force(self, speed_m_s: float, current_A: float) -> float:
        """Return the force [N] of the oil at a constant speed [m/s] and current [A], without gas and inertia."""
        run = ChambersRun(self, STILL)
        setting, sign = self.valve.steady(current_A), (speed_m_s > 0.0) - (speed_m_s < 0.0)
        p_c, p_r = run.settle(speed_m_s, setting)
        friction = sign * self.side.friction_N * (1.0 + self.friction_growth_1_N * max(p_r, 0.0))
        return (1.0 + self.area_ratio) * p_c - p_r + friction

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

    def certify(self, within: OperatingRange) -> EnergyCertificate:
        """Return the proved bounds on |force| [N]."""
        envelope, any_input = (self._bound(inputs) for inputs in (within.inputs, widen(within.inputs, self.reach)))
        return EnergyCertificate(envelope, any_input, CLAIM, METHOD.format(DIRECTIONS))

    def is_stable(self, within: OperatingRange) -> bool:
        """Return True: every model that `from_json` accepts has increasing flows and positive compliances."""
        return True

    def _bound(self, inputs: Ranges) -> float:
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


def bound_energy(model: Chambers, fastest: float) -> float:
    """Return a bound on 1/2 P' S P over all P with P' L(P) <= fastest |a' P|: no run from rest has more energy.

    Along a ray P = t d, d' L(t d) rises with t, so the set ends at one t. For each interval of directions that t is
    bounded with the least dissipation and the largest drive of the interval, over all settings of the valve.
    """
    flows = _Flows(model)
    most = 0.0
    for k in range(DIRECTIONS):
        d_c, d_r = _range(cos, k), _range(sin, k)
        force = flows.largest_force(d_c, d_r)
        end = flows.reach(d_c, d_r, fastest * force)
        c, r = max(map(abs, d_c)), max(map(abs, d_r))
        stored = model.compression_m_N * c * c + model.rebound_m_N * r * r + model.mount_m_N * force * force
        most = max(most, 0.5 * stored * end * end)
    return most * (1.0 + ROUNDING)


class _Flows:
    """The least dissipation d' L(t d) [m/s] over an interval of directions d, for every setting of the valve."""

    def __init__(self, model: Chambers) -> None:
        self._ratio = 1.0 + model.area_ratio
        self._check, self._refill = model.check, model.refill
        self._valves = [IncreasingCurve(curve.values, curve.at) for curve in (model.map.highest, model.map.lowest)]

    def largest_force(self, d_c: Range, d_r: Range) -> float:
        """Return the largest |a' d| of the directions."""
        ends = self._ratio * d_c[0] - d_r[1], self._ratio * d_c[1] - d_r[0]
        return max(map(abs, ends)) * (1.0 + ROUNDING)

    def reach(self, d_c: Range, d_r: Range, driven: float) -> float:
        """Return a length t [N] from which on every direction dissipates more than `driven`; infinite if none."""
        high = 1.0
        while self._dissipated(d_c, d_r, high) <= driven:
            high *= 2.0
            if high > MAX_PRESSURE_N:
                return inf
        low = 0.0 if high == 1.0 else 0.5 * high
        while high - low > 1e-3 * high:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self._dissipated(d_c, d_r, middle) > driven else (middle, high)
        return high

    def _dissipated(self, d_c: Range, d_r: Range, t: float) -> float:
        total = _least(self._check, (d_c[0] - d_r[1], d_c[1] - d_r[0]), t)
        total += _least(self._refill, (-d_c[1], -d_c[0]), t)
        return total + min(_least(valve, d_r, t) for valve in self._valves)


def _range(function: Callable[[float], float], k: int) -> Range:
    """Return the range of cos or sin over the k-th interval of angles, none of which crosses a quarter turn."""
    ends = [function(2.0 * pi * n / DIRECTIONS) for n in (k, k + 1)]
    return min(ends) - 1e-12, max(ends) + 1e-12


def _least(curve: IncreasingCurve, d: Range, t: float) -> float:
    """Return the least d curve(t d) over the interval; a curve through the origin has its least nearest to it."""
    if d[0] < 0.0 < d[1]:
        return 0.0
    return min(end * curve(t * end) for end in d)


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


class ChambersRun:
    """The free run of a model with chambers; `clamped` is True if the last inputs were outside the envelope."""

    def __init__(self, model: Chambers, within: OperatingRange) -> None:
        self._interval = interval = 1.0 / within.rate_Hz
        self._inputs = InputLimiter(within, model.reach)
        self._valve = ValveRun(model.valve, interval)
        self._side = SideRun(model.side, interval)
        self._map, self._growth = model.map, model.friction_growth_1_N
        self._drops, self._flows = model.check.at, segments(model.check.at, model.check.values)
        self._suctions, self._refills = model.refill.at, segments(model.refill.at, model.refill.values)
        self._ratio = ratio = 1.0 + model.area_ratio
        mount = model.mount_m_N
        self._stored = model.compression_m_N + ratio * ratio * mount, -ratio * mount, model.rebound_m_N + mount
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
        self._pressures = 0.0, 0.0
        self._pieces = 0, 0, 0
        self._inputs.outside = False

    def tick(self, position: float, speed: float, current: float) -> float:
        """Return the force [N] at this tick; infinite if it left the force envelope."""
        position, speed, current = self._inputs.limit(position, speed, current)
        setting = self._valve.tick(current)
        side = self._side
        drive = side.drive(speed)
        p_c, p_r = self._advance(drive, setting)
        force = self._ratio * p_c - p_r + side.others(position, drive)
        if side.has_friction:
            force += side.friction(drive) * (1.0 + self._growth * p_r if p_r > 0.0 else 1.0)
        low, high = self._limits
        return force if low <= force <= high else inf

    def settle(self, speed: float, setting: float) -> tuple[float, float]:
        """Return both pressures [N] after a long time at a constant speed [m/s] and setting, here in one long step."""
        self._pressures = 0.0, 0.0
        return self._advance(speed, setting)

    def _advance(self, drive: float, setting: float) -> tuple[float, float]:
        """Solve the step for both pressures; from piece to piece of the curves, which mostly ends at once."""
        s_cc, s_cr, s_rr = self._stored
        interval, ratio = self._interval, self._ratio
        p_c, p_r = self._pressures
        b_c = s_cc * p_c + s_cr * p_r + interval * ratio * drive
        b_r = s_cr * p_c + s_rr * p_r - interval * drive
        at, (row, share) = self._map.at, self._map.pick(setting)
        below, above = self._map.rows[row], self._map.rows[row + 1]
        flows, refills, drops, suctions = self._flows, self._refills, self._drops, self._suctions
        i, j, k = self._pieces
        for _ in range(QUICK_STEPS):
            c0, c1 = flows[i]
            r0, r1 = refills[j]
            left = below[k] + share * (above[k] - below[k])
            v1 = (at[k + 1] - at[k]) / (below[k + 1] + share * (above[k + 1] - below[k + 1]) - left)
            v0 = at[k] - v1 * left
            a_cc, a_cr, a_rr = s_cc + interval * (c1 + r1), s_cr - interval * c1, s_rr + interval * (c1 + v1)
            e_c, e_r = b_c - interval * (c0 - r0), b_r + interval * (c0 - v0)
            determinant = a_cc * a_rr - a_cr * a_cr
            p_c, p_r = (a_rr * e_c - a_cr * e_r) / determinant, (a_cc * e_r - a_cr * e_c) / determinant
            pieces = (
                pick_segment(drops, p_c - p_r, i),
                pick_segment(suctions, -p_c, j),
                _pick_blend(below, above, share, p_r, k),
            )
            if pieces == (i, j, k):
                break
            i, j, k = pieces
        else:
            p_c, p_r = self._search(b_c, b_r, below, above, share)
            i, j, k = 0, 0, 0
        self._pieces, self._pressures = (i, j, k), (p_c, p_r)
        return p_c, p_r

    def _search(
        self, b_c: float, b_r: float, below: Sequence[float], above: Sequence[float], share: float
    ) -> tuple[float, float]:
        """Solve the step by Newton's method with a line search on the convex function that the step minimises."""
        p_c, p_r = self._pressures
        f_c, f_r, a_cc, a_cr, a_rr = self._evaluate(p_c, p_r, b_c, b_r, below, above, share)
        for _ in range(MAX_STEPS):
            determinant = a_cc * a_rr - a_cr * a_cr
            d_c, d_r = (a_cr * f_r - a_rr * f_c) / determinant, (a_cr * f_c - a_cc * f_r) / determinant
            if abs(d_c) + abs(d_r) <= CLOSE * (1.0 + abs(p_c) + abs(p_r)):
                break
            first = f_c * d_c + f_r * d_r
            low, high, t = 0.0, 1.0, 1.0
            for _ in range(MAX_STEPS):
                f_c, f_r, a_cc, a_cr, a_rr = self._evaluate(p_c + t * d_c, p_r + t * d_r, b_c, b_r, below, above, share)
                slope = f_c * d_c + f_r * d_r
                if abs(slope) <= -0.5 * first or high - low < 1e-15 or (t == 1.0 and slope < 0.0):
                    break
                low, high = (low, t) if slope > 0.0 else (t, high)
                t = 0.5 * (low + high)
            p_c, p_r = p_c + t * d_c, p_r + t * d_r
        return p_c, p_r

    def _evaluate(
        self,
        p_c: float,
        p_r: float,
        b_c: float,
        b_r: float,
        below: Sequence[float],
        above: Sequence[float],
        share: float,
    ) -> tuple[float, float, float, float, float]:
        """Return both residuals of the step [m] and its symmetric matrix [m/N]."""
        s_cc, s_cr, s_rr = self._stored
        interval, at = self._interval, self._map.at
        c0, c1 = self._flows[pick_segment(self._drops, p_c - p_r, 0)]
        r0, r1 = self._refills[pick_segment(self._suctions, -p_c, 0)]
        k = _pick_blend(below, above, share, p_r, 0)
        left = below[k] + share * (above[k] - below[k])
        v1 = (at[k + 1] - at[k]) / (below[k + 1] + share * (above[k + 1] - below[k + 1]) - left)
        across, refill, valve = c0 + c1 * (p_c - p_r), r0 - r1 * p_c, at[k] + v1 * (p_r - left)
        return (
            s_cc * p_c + s_cr * p_r - b_c + interval * (across - refill),
            s_cr * p_c + s_rr * p_r - b_r + interval * (valve - across),
            s_cc + interval * (c1 + r1),
            s_cr - interval * c1,
            s_rr + interval * (c1 + v1),
        )


def _pick_blend(below: Sequence[float], above: Sequence[float], share: float, at: float, last: int) -> int:
    """Return the index of the piece of a blend of two curves that holds the value `at`, searched from `last` on."""
    end = len(below) - 2
    while last < end and at > below[last + 1] + share * (above[last + 1] - below[last + 1]):
        last += 1
    while last > 0 and at <= below[last] + share * (above[last] - below[last]):
        last -= 1
    return last
