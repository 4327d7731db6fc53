"""Parts of a structure with physics inside: valve path, side forces, and how far it extrapolates.

`ces_observer.tick.valve` leads from the current to the valve's setting; `ces_observer.tick.mount` has the friction
elements, and `ces_observer.tick.hydraulic` the drive and the forces on the rod in parallel to the oil's.

Curves go on straight beyond what was recorded. Inputs outside the envelope are used as they are, and marked, up to
`reach` times the envelope about its middle (for the speed about zero); beyond, they are clamped. The proof covers all
of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Any, Self

from ces_observer.errors import ModelError
from ces_observer.flat import Layout
from ces_observer.json_text import JsonObject
from ces_observer.proof.intervals import up
from ces_observer.structures.curves import MAX_VALUE, IncreasingCurve, check_slopes, interpolate, parse_nodes
from ces_observer.structures.structure import INPUTS, MAX_LAG, OperatingRange, Range, Ranges
from ces_observer.tick import hydraulic as tick
from ces_observer.tick import valve

MAX_REACH = 10.0


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
MAX_LAG_S = 1.0
VALVE_KEYS = ("current_A", "setting", "delay_ticks", "hysteresis_A", "rise_s", "fall_s")


@dataclass(frozen=True)
class ValvePath:
    """The valve's characteristic (setting over current [A], from 0 to 1) and its dynamics."""

    characteristic: IncreasingCurve
    delay_ticks: float
    hysteresis_A: float
    rise_s: float
    fall_s: float

    def steady(self, current_A: float) -> float:
        """Return the setting at a constant current [A], in the middle of the magnetic loop."""
        return min(max(interpolate(self.characteristic.at, self.characteristic.values, current_A), 0.0), 1.0)

    def to_json(self) -> dict[str, Any]:
        """Return the contents of the model file."""
        return {
            **self.characteristic.to_json("current_A", "setting"),
            "delay_ticks": self.delay_ticks,
            "hysteresis_A": self.hysteresis_A,
            "rise_s": self.rise_s,
            "fall_s": self.fall_s,
        }

    def fill(self, layout: Layout, interval_s: float) -> None:
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

    @classmethod
    def from_json(cls, node: JsonObject) -> Self:
        """Check it in a model file; raises ModelError."""
        node.require_only_keys(*VALVE_KEYS)
        currents = parse_nodes(node, "current_A")
        settings = parse_nodes(node, "setting", len(currents))
        check_slopes(node.where, currents, settings)
        if settings[0] != 0.0 or settings[-1] != 1.0:
            raise ModelError(f"{node.where}: setting runs from {settings[0]:g} to {settings[-1]:g}; expected 0 to 1")
        return cls(
            IncreasingCurve(currents, settings),
            node.number("delay_ticks", 0.0, MAX_LAG - 1),
            node.number("hysteresis_A", 0.0, 1e3),
            node.number("rise_s", 0.0, MAX_LAG_S),
            node.number("fall_s", 0.0, MAX_LAG_S),
        )


MAX_FRICTION = 8
MAX_LEAD_S = 0.1
SIDE_KEYS = ("lead_s", "max_acceleration_m_s2", "viscous_Ns_m", "mass_kg", "position_m", "gas_N", "friction")


@dataclass(frozen=True)
class FrictionElement:
    """A spring whose force is limited: stiffness [N/m], yield force [N], and how much the valve's setting adds [N]."""

    stiffness_N_m: float
    yield_N: float
    moved_N: float = 0.0


@dataclass(frozen=True)
class SideForces:
    """The drive's lead and the forces beside the oil's; `gas_N` is the force over `position_m`, straight beyond."""

    lead_s: float
    max_acceleration_m_s2: float
    viscous_Ns_m: float
    mass_kg: float
    position_m: tuple[float, ...]
    gas_N: tuple[float, ...]
    friction: tuple[FrictionElement, ...]

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

    def to_json(self) -> dict[str, Any]:
        """Return the contents of the model file."""
        return {
            **{key: getattr(self, key) for key in SIDE_KEYS[:4]},
            "position_m": list(self.position_m),
            "gas_N": list(self.gas_N),
            "friction": [vars(one) for one in self.friction],
        }

    def fill(self, layout: Layout, interval_s: float) -> None:
        """Write its numbers for `ces_observer.tick.hydraulic`, without friction, at ticks of `interval_s`."""
        layout.p[tick.DRIVE_LEAD] = self.lead_s
        layout.p[tick.MAX_ACCELERATION] = self.max_acceleration_m_s2
        layout.p[tick.DRIVE_RATE] = 1.0 / interval_s
        layout.p[tick.VISCOUS] = self.viscous_Ns_m
        layout.p[tick.MASS] = self.mass_kg
        layout.n[tick.GAS_NODES] = len(self.position_m)
        layout.n[tick.GAS_POSITIONS] = layout.table(self.position_m)
        layout.n[tick.GAS_FORCES] = layout.table(self.gas_N)

    @classmethod
    def from_json(cls, node: JsonObject) -> Self:
        """Check it in a model file; raises ModelError."""
        node.require_only_keys(*SIDE_KEYS)
        positions = parse_nodes(node, "position_m")
        gas = parse_nodes(node, "gas_N", len(positions), rising=False)
        check_slopes(node.where, positions, gas, rising=False)
        return cls(
            node.number("lead_s", -MAX_LEAD_S, MAX_LEAD_S),
            node.number("max_acceleration_m_s2", 0.0, MAX_VALUE),
            node.number("viscous_Ns_m", 0.0, MAX_VALUE),
            node.number("mass_kg", 0.0, MAX_VALUE),
            positions,
            gas,
            tuple(parse_friction(item) for item in node.items("friction", 0, MAX_FRICTION)),
        )


def parse_friction(node: JsonObject) -> FrictionElement:
    """Check a friction element of a model file; raises ModelError."""
    node.require_only_keys("stiffness_N_m", "yield_N", "moved_N")
    forces = (node.number(name, 0.0, MAX_VALUE) for name in ("yield_N", "moved_N"))
    return FrictionElement(node.number("stiffness_N_m", 1e-9, 1e12), *forces)


LONG_TICK = OperatingRange(1e-6, dict.fromkeys(INPUTS, (-inf, inf)), (-inf, inf))  # in which every lag dies out


def yield_at_mid_stroke(stiffness_N_m: float, yield_N: float, half_m: float) -> float:
    """Return the force [N] of a yielding spring in the middle of strokes to +-`half_m` [m].

    It leaves an end with the force -min(yield, stiffness half): without yielding there, it is relaxed in the middle.
    """
    return min(max(stiffness_N_m * half_m - yield_N, 0.0), yield_N)
