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

`ces_observer.tick.valve` leads from the current to the valve's setting; `ces_observer.tick.mount` has the friction
elements, and `ces_observer.tick.hydraulic` the drive and the forces on the rod in parallel to the oil's. Curves go on
straight beyond what was recorded. Inputs outside the envelope are used as they are, and marked, up to `reach` times the
envelope about its middle (for the speed about zero); beyond, they are clamped. The proof covers all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain, pairwise
from math import exp, inf
from sys import float_info
from typing import Self

from ces_observer.errors import ModelError
from ces_observer.fields import REQUIRED
from ces_observer.flat import ArrayLayout
from ces_observer.limits import FileLimits, NumberLimits
from ces_observer.proof.certificate import ENERGY_CLAIM, EnergyCertificate
from ces_observer.proof.intervals import up
from ces_observer.records import bounded, choice, items, part
from ces_observer.structures.curves import Bypass, FlowMap, IncreasingCurve, check_over_stroke, interpolate, nodes
from ces_observer.structures.structure import INPUTS, OperatingRange, Range, Ranges, Structure
from ces_observer.tick import edges, mount, pressures, valve
from ces_observer.tick import hydraulic as tick
from ces_observer.tick.pressures import ROUNDING, WARMING_S
from ces_observer.tick.structure import HYDRAULIC
from ces_observer.tick.valve import KEEP


def widen(inputs: Ranges, reach: float) -> dict[str, Range]:
    """Return the ranges of the inputs `reach` times as wide."""
    low, high = inputs["speed"]
    return {
        "position": _about_middle(inputs["position"], reach),
        "speed": (min(low, reach * low), max(high, reach * high)),
        "current": _about_middle(inputs["current"], reach),
    }


def _about_middle(one: Range, reach: float) -> Range:
    middle, half = 0.5 * (one[0] + one[1]), 0.5 * reach * (one[1] - one[0])
    return min(one[0], middle - half), max(one[1], middle + half)


PLAYS = (1.0 / 3.0, 1.0, 5.0 / 3.0)  # half widths relative to their mean


@dataclass(frozen=True)
class ValvePath:
    """The valve's characteristic (setting over current [A], from 0 to 1) and its dynamics."""

    characteristic: IncreasingCurve = part(inline=True)
    delay_ticks: float = bounded(0.0, FileLimits.MAX_LAG - 1)
    hysteresis_A: float = bounded(0.0, 1e3)
    rise_s: float = bounded(0.0, FileLimits.MAX_VALVE_S)
    fall_s: float = bounded(0.0, FileLimits.MAX_VALVE_S)

    def steady(self, current_A: float) -> float:
        """Return the setting at a constant current [A], in the middle of the magnetic loop."""
        return min(max(interpolate(self.characteristic.at, self.characteristic.values, current_A), 0.0), 1.0)

    def fill(self, layout: ArrayLayout, interval_s: float) -> None:
        """Write its numbers for `ces_observer.tick.valve`, at ticks of `interval_s`."""
        whole = int(self.delay_ticks)
        layout.p[valve.VALVE_PART] = self.delay_ticks - whole
        layout.p[valve.VALVE_RISE] = interval_s / (self.rise_s + interval_s)
        layout.p[valve.VALVE_FALL] = interval_s / (self.fall_s + interval_s)
        layout.put(valve.PLAY_HALF, (self.hysteresis_A * play for play in PLAYS))
        layout.n[valve.VALVE_DELAY] = whole
        layout.n[valve.VALVE_NODES] = len(self.characteristic.at)
        layout.n[valve.VALVE_CURRENTS] = layout.table(self.characteristic.at)
        layout.n[valve.VALVE_SETTINGS] = layout.table(self.characteristic.values)
        layout.n[valve.VALVE_RING] = layout.state(whole + 2)


@dataclass(frozen=True)
class FrictionElement:
    """A spring whose force is limited: stiffness [N/m], yield force [N], and how much the valve's setting adds [N]."""

    stiffness_N_m: float = bounded(1e-9, 1e12)
    yield_N: float = bounded(0.0, NumberLimits.MAX_NUMBER)
    moved_N: float = bounded(0.0, NumberLimits.MAX_NUMBER, default=0.0)


@dataclass(frozen=True)
class SideForces:
    """The drive's lead and the forces beside the oil's; `gas_N` is the force over `position_m`, straight beyond."""

    lead_s: float = bounded(-FileLimits.MAX_LEAD_S, FileLimits.MAX_LEAD_S)
    max_acceleration_m_s2: float = bounded(0.0, NumberLimits.MAX_NUMBER)
    viscous_Ns_m: float = bounded(0.0, NumberLimits.MAX_NUMBER)
    mass_kg: float = bounded(0.0, NumberLimits.MAX_NUMBER)
    position_m: tuple[float, ...] = nodes("position_m")
    gas_N: tuple[float, ...] = nodes("gas_N")
    friction: tuple[FrictionElement, ...] = items(0, FileLimits.MAX_FRICTION)

    def checked(self) -> Self:
        """Return it; raises ModelError if the gas force is no curve over the stroke."""
        check_over_stroke("gas_N", self.position_m, self.gas_N)
        return self

    def gas(self, position_m: float) -> float:
        """Return the force [N] of gas and preload at a position [m]."""
        return interpolate(self.position_m, self.gas_N, position_m)

    def max_drive(self, speed: Range) -> float:
        """Return a bound on |drive| [m/s] for speeds in the range."""
        return up(max(map(abs, speed)) + up(abs(self.lead_s) * self.max_acceleration_m_s2))

    def bound_N(self, inputs: Ranges) -> float:
        """Return a bound on |side force| [N], without friction, for inputs in their ranges."""
        low, high = inputs["position"]
        nodes = [x for x in self.position_m if low < x < high]
        gas = max(abs(self.gas(x)) for x in (low, high, *nodes))
        viscous = self.viscous_Ns_m * self.max_drive(inputs["speed"])
        return (gas + viscous + self.mass_kg * self.max_acceleration_m_s2) * (1.0 + 1e-12)

    @property
    def friction_N(self) -> float:
        """Bound on the force of all friction elements [N]."""
        return sum(one.yield_N + one.moved_N for one in self.friction) * (1.0 + 1e-12)

    def fill(self, layout: ArrayLayout, interval_s: float) -> None:
        """Write its numbers for `ces_observer.tick.hydraulic`, without friction, at ticks of `interval_s`."""
        layout.p[tick.DRIVE_LEAD] = self.lead_s
        layout.p[tick.MAX_ACCELERATION] = self.max_acceleration_m_s2
        layout.p[tick.DRIVE_RATE] = 1.0 / interval_s
        layout.p[tick.VISCOUS] = self.viscous_Ns_m
        layout.p[tick.MASS] = self.mass_kg
        layout.n[tick.GAS_NODES] = len(self.position_m)
        layout.n[tick.GAS_POSITIONS] = layout.table(self.position_m)
        layout.n[tick.GAS_FORCES] = layout.table(self.gas_N)


LONG_TICK = OperatingRange(1e-6, dict.fromkeys(INPUTS, (-inf, inf)), (-inf, inf))  # in which every lag dies out


def yield_at_mid_stroke(stiffness_N_m: float, yield_N: float, half_m: float) -> float:
    """Return the force [N] of a yielding spring in the middle of strokes to +-`half_m` [m].

    It leaves an end with the force -min(yield, stiffness half): without yielding there, it is relaxed in the middle.
    """
    return min(max(stiffness_N_m * half_m - yield_N, 0.0), yield_N)


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
FORGETS = "without it the model never forgets: identify it again"


@dataclass(frozen=True)
class Hydraulic(Structure):
    """A hydraulic network; compliances [m/N] of both chambers, flows as speeds [m/s]; `kind` is one of KINDS."""

    name, section, option, rank = "hydraulic", "hydraulic", "hydraulic", 3
    number, runs = HYDRAULIC, (tick.hydraulic_reset, tick.hydraulic_tick)
    forgets_by_proof = False
    extrapolates, unproved = True, "its force is not proved to be bounded for every input"

    kind: str = choice(REQUIRED, "", KINDS)
    valve: ValvePath = part()
    area_ratio: float = bounded(0.0, 100.0)
    compression_m_N: float = bounded(1e-12, 1.0)
    rebound_m_N: float = bounded(1e-12, 1.0)
    compression_growth_1_m: float = bounded(-1e3, 1e3)
    rebound_growth_1_m: float = bounded(-1e3, 1e3)
    mount_m_N: float = bounded(0.0, 1.0)
    creep_m_Ns: float = bounded(0.0, 1.0)
    fade_1_W: float = bounded(-1.0, 1.0)
    reservoir_N: float = bounded(1e-3, NumberLimits.MAX_NUMBER)
    air: float = bounded(0.0, 1e6)
    most_N: float = bounded(1.0, NumberLimits.MAX_NUMBER)
    bypass_laminar_N: float = bounded(1e-6, NumberLimits.MAX_NUMBER)
    laminar_N: float = bounded(1e-6, NumberLimits.MAX_NUMBER)
    piston_s: float = bounded(0.0, 1.0)
    base_s: float = bounded(0.0, 1.0)
    external_s: float = bounded(0.0, 1.0)
    friction_growth_1_N: float = bounded(0.0, NumberLimits.MAX_NUMBER)
    relax_s: float = bounded(1e-3, NEVER_S, remedy=FORGETS)
    leak_s: float = bounded(1e-3, NEVER_S, remedy=FORGETS)
    piston: FlowMap = part()
    base: FlowMap = part()
    external: FlowMap = part()
    bypass: Bypass | None = part(null={})
    side: SideForces = part()
    reach: float = bounded(1.0, FileLimits.MAX_REACH)

    def checked(self) -> Self:
        """Return it; raises ModelError unless all edges have the same flows."""
        if len({getattr(self, edge).at for edge in EDGES}) > 1:
            raise ModelError("the edges have different flow_m_s; expected the same for all")
        return self

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

    def fill(self, layout: ArrayLayout, within: OperatingRange) -> None:
        """Write its numbers into a layout."""
        rate = within.rate_Hz
        layout.reserve(tick.P_HYDRAULIC_END, tick.N_HYDRAULIC_END, tick.S_HYDRAULIC_END, tick.K_HYDRAULIC_END)
        wide = [end for ends in widen(within.inputs, self.reach).values() for end in ends]
        layout.put(tick.WIDE_POSITION_LOW, map(_as_number, wide))
        self.valve.fill(layout, 1.0 / rate)
        self.side.fill(layout, 1.0 / rate)
        layout.p[KEEP] = exp(-1.0 / (rate * self.relax_s))
        self._fill_mount(layout, rate)
        self._fill_edges(layout, rate)
        self._fill_chambers(layout, rate)

    def _fill_chambers(self, layout: ArrayLayout, rate_Hz: float) -> None:
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

    def _fill_edges(self, layout: ArrayLayout, rate_Hz: float) -> None:
        lags = (self.piston_s, self.base_s, self.external_s)
        for n, (flow, lag) in enumerate(zip((self.piston, self.base, self.external), lags, strict=True)):
            layout.p[edges.EDGE_SHARE + n] = 1.0 / (1.0 + rate_Hz * lag)
            layout.n[edges.EDGE_NODES + n] = len(flow.at)
            layout.n[edges.LAST_ROW + n] = len(flow.rows) - 1
            layout.n[edges.EDGE_FLOWS + n] = layout.table(flow.at)
            layout.n[edges.EDGE_DROPS + n] = layout.table(chain(*flow.rows))

    def _fill_mount(self, layout: ArrayLayout, rate_Hz: float) -> None:
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
        leak = 1.0 / (self.leak_s * LONG_TICK.rate_Hz)  # of the volumes in such a tick, which ends empty
        names = ("compression_m_N", "rebound_m_N")
        run = replace(body, **{name: leak * getattr(body, name) for name in names}).make_predictor(LONG_TICK)
        return run.tick(0.5 * (low + high), speed_m_s, current_A)

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

    def certify(self, within: OperatingRange) -> EnergyCertificate:
        """Return the proved bounds on |force| [N]; the force is held within its range, too."""
        most = max(map(abs, within.force_N))
        ranges = within.inputs, widen(within.inputs, self.reach)
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
