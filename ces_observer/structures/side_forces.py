"""What all models with physics inside share beside their core: the drive, and the forces in parallel to the oil.

    acceleration(k) = (speed(k) - speed(k-1)) / T, limited to +-`max_acceleration`
    drive(k)        = speed(k) + lead acceleration(k), the speed [m/s] that moves the oil
    side force(k)   = gas(position) + viscous drive + mass acceleration + sum of friction elements

A friction element is a spring with a limited force (Prandtl 1928): f(k) = clip(f(k-1) + stiffness T drive(k), -+yield).
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from typing import Any, Self

from ces_observer.json_checks import JsonObject
from ces_observer.proof.intervals import up
from ces_observer.structures.increasing_curves import MAX_VALUE, check_slopes, interpolate, parse_nodes, pieces
from ces_observer.structures.structure import Range, Ranges

MAX_FRICTION = 8
MAX_LEAD_S = 0.1
KEYS = (
    "lead_s",
    "max_acceleration_m_s2",
    "viscous_Ns_m",
    "mass_kg",
    "position_m",
    "gas_N",
    "friction",
)


@dataclass(frozen=True)
class FrictionElement:
    """A spring whose force is limited: stiffness [N/m] and yield force [N]."""

    stiffness_N_m: float
    yield_N: float


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
        return sum(one.yield_N for one in self.friction) * (1.0 + 1e-12)

    def to_json(self) -> dict[str, Any]:
        """Return the contents of the model file."""
        return {
            **{key: getattr(self, key) for key in KEYS[:4]},
            "position_m": list(self.position_m),
            "gas_N": list(self.gas_N),
            "friction": [vars(one) for one in self.friction],
        }

    @classmethod
    def from_json(cls, node: JsonObject) -> Self:
        """Check it in a model file; raises ModelError."""
        node.require_only_keys(*KEYS)
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
    node.require_only_keys("stiffness_N_m", "yield_N")
    return FrictionElement(node.number("stiffness_N_m", 1e-9, 1e12), node.number("yield_N", 0.0, MAX_VALUE))


class SideRun:
    """The past of drive and friction."""

    def __init__(self, side: SideForces, interval_s: float) -> None:
        self._rate = 1.0 / interval_s
        self._numbers = side.lead_s, side.max_acceleration_m_s2, side.viscous_Ns_m, side.mass_kg
        self._inner, self._gas = side.position_m[1:-1], pieces(side.position_m, side.gas_N)
        self._elements = [(n, one.stiffness_N_m * interval_s, one.yield_N) for n, one in enumerate(side.friction)]
        self.reset()

    def reset(self) -> None:
        """Forget the past: no acceleration, no friction."""
        self._speed: float | None = None
        self._rubbing = [0.0] * len(self._elements)

    def tick(self, position: float, speed: float) -> tuple[float, float]:
        """Return the speed [m/s] that moves the oil at this tick, and gas, viscous and inertia force [N]."""
        before, self._speed = self._speed, speed
        lead, limit, viscous, mass = self._numbers
        change = 0.0 if before is None else (speed - before) * self._rate
        if change > limit:
            change = limit
        elif change < -limit:
            change = -limit
        drive = speed + lead * change
        at, gas, slope = self._gas[bisect_left(self._inner, position)]
        return drive, gas + slope * (position - at) + viscous * drive + mass * change

    def friction(self, drive: float) -> float:
        """Return the force [N] of the friction elements after this tick's drive [m/s]."""
        rubbing, total = self._rubbing, 0.0
        for n, step, limit in self._elements:
            force = rubbing[n] + step * drive
            if force > limit:
                force = limit
            elif force < -limit:
                force = -limit
            rubbing[n] = force
            total += force
        return total
