"""What the structures with physics inside share: valve path, side forces, how far they extrapolate, and their proof.

The valve path leads from current to the valve's setting: dead time, remanence, characteristic and pilot lag; current
in, 0 to 1 out.

    delayed(k) = current(k - delay), interpolated between ticks
    remanence  = mean of plays of half widths 1/3, 1 and 5/3 of `hysteresis_A` (Prandtl-Ishlinskii operator)
    target     = characteristic(remanence), rising from 0 to 1, constant beyond its ends
    setting(k) = setting(k-1) + T / (lag + T) (target - setting(k-1)), with one lag for rising and one for falling

Every stage is driven by the current alone and none amplifies a difference, so the setting stays within 0 to 1.

Beside the core of each stand the drive, and the forces on the rod in parallel to it:

    acceleration(k) = (speed(k) - speed(k-1)) / T, limited to +-`max_acceleration`
    drive(k)        = speed(k) + lead acceleration(k), the speed [m/s] that moves the oil
    side force(k)   = gas(position) + viscous drive + mass acceleration

A friction element is a spring with a limited force (Prandtl 1928): z(k) = clip(z(k-1) + stiffness way(k), -+limit),
with limit = yield + setting moved: what a field makes stiff yields later. The way is that behind mounts that give way.

Curves go on straight beyond what was recorded. Inputs outside the envelope are used as they are, and marked, up to
`reach` times the envelope about its middle (for the speed about zero); beyond, they are clamped. The proof covers all
of them.
"""

from __future__ import annotations

from abc import abstractmethod
from bisect import bisect_left
from collections import deque
from dataclasses import dataclass
from math import inf
from typing import Any, ClassVar, Self

from ces_observer.errors import ModelError
from ces_observer.json_text import JsonObject
from ces_observer.proof.certificate import ENERGY_CLAIM, EnergyCertificate
from ces_observer.proof.intervals import up
from ces_observer.structures.curves import (
    MAX_VALUE,
    IncreasingCurve,
    Piece,
    check_slopes,
    interpolate,
    parse_nodes,
    pieces,
)
from ces_observer.structures.structure import MAX_LAG, OperatingRange, Range, Ranges, Structure

MAX_REACH = 10.0
INPUTS = ("position", "speed", "current")


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


class InputLimiter:
    """Marks inputs outside the envelope and clamps those beyond its reach; `outside` is that of the last inputs."""

    def __init__(self, within: OperatingRange, reach: float) -> None:
        self._envelope = tuple(bound for name in INPUTS for bound in within.inputs[name])
        wide = widen(within.inputs, reach)
        self._limits = tuple(bound for name in INPUTS for bound in wide[name])
        self.outside = False

    def limit(self, position: float, speed: float, current: float) -> tuple[float, float, float]:
        """Return the inputs [m, m/s, A], clamped where they are beyond reach."""
        x0, x1, v0, v1, c0, c1 = self._envelope
        if x0 <= position <= x1 and v0 <= speed <= v1 and c0 <= current <= c1:
            self.outside = False
            return position, speed, current
        self.outside = True
        x0, x1, v0, v1, c0, c1 = self._limits
        return min(max(position, x0), x1), min(max(speed, v0), v1), min(max(current, c0), c1)


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

    @property
    def max_lag(self) -> int:
        """Longest lag of the current in ticks."""
        return int(self.delay_ticks) + 1

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


class ValveRun:
    """The valve's past."""

    def __init__(self, path: ValvePath, interval_s: float) -> None:
        self._path = path
        whole = int(path.delay_ticks)
        self._share = path.delay_ticks - whole
        self._currents: deque[float] = deque(maxlen=whole + 2)  # the oldest first
        self._halves = tuple(path.hysteresis_A * play for play in PLAYS) if path.hysteresis_A > 0.0 else ()
        self._nodes, self._pieces = _between_0_and_1(path.characteristic)
        self._rise = interval_s / (path.rise_s + interval_s)
        self._fall = interval_s / (path.fall_s + interval_s)
        self.reset()

    def reset(self) -> None:
        """Forget the past: earlier currents equal the first one to come."""
        self._currents.clear()
        self._plays = 0.0, 0.0, 0.0
        self._setting = 0.0

    def tick(self, current: float) -> float:
        """Return the setting after this tick's current [A]."""
        currents = self._currents
        if not currents:
            currents.extend([current] * (currents.maxlen or 0))
            self._plays = current, current, current
            self._setting = self._path.steady(current)
        currents.append(current)
        newer = currents[1]
        remanent = newer + self._share * (currents[0] - newer)
        if self._halves:
            a, b, c = self._plays
            for_a, for_b, for_c = self._halves
            a = low if a < (low := remanent - for_a) else high if a > (high := remanent + for_a) else a
            b = low if b < (low := remanent - for_b) else high if b > (high := remanent + for_b) else b
            c = low if c < (low := remanent - for_c) else high if c > (high := remanent + for_c) else c
            self._plays = a, b, c
            remanent = (a + b + c) / 3.0
        at, value, slope = self._pieces[bisect_left(self._nodes, remanent)]
        setting = self._setting
        change = value + slope * (remanent - at) - setting
        self._setting = setting = setting + (self._rise if change > 0.0 else self._fall) * change
        return setting


def _between_0_and_1(curve: IncreasingCurve) -> tuple[tuple[float, ...], tuple[Piece, ...]]:
    """Return ends and pieces of a curve that goes on straight to 0 and 1, and stays there."""
    inner = pieces(curve.at, curve.values)
    (first, low, rising), (last, high, falling) = inner[0], inner[-1]
    first, last = first - low / rising, last + (1.0 - high) / falling
    return (first, *curve.at[1:-1], last), ((first, 0.0, 0.0), *inner, (last, 1.0, 0.0))


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


class SideRun:
    """The past of the drive."""

    def __init__(self, side: SideForces, interval_s: float) -> None:
        self._rate = 1.0 / interval_s
        self._numbers = side.lead_s, side.max_acceleration_m_s2, side.viscous_Ns_m, side.mass_kg
        self._inner, self._gas = side.position_m[1:-1], pieces(side.position_m, side.gas_N)
        self.reset()

    def reset(self) -> None:
        """Forget the past: no acceleration."""
        self._speed: float | None = None

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


LONG_TICK = OperatingRange(1e-6, dict.fromkeys(INPUTS, (-inf, inf)), (-inf, inf))  # in which every lag dies out


class PhysicalStructure(Structure):
    """A structure of increasing curves, solved implicitly; `method` says how its force was bounded."""

    extrapolates: ClassVar[bool] = True
    unproved: ClassVar[str] = "its force is not proved to be bounded for every input"
    method: ClassVar[str]

    valve: ValvePath
    side: SideForces
    reach: float

    @property
    def max_lag(self) -> int:
        """Longest lag of any signal in ticks."""
        return self.valve.max_lag

    @property
    def outside(self) -> str:
        """What becomes of inputs outside the envelope."""
        return f"used as they are up to {self.reach:g} times the envelope, and clamped beyond"

    def steady_force(self, within: OperatingRange, speed_m_s: float, current_A: float) -> float:
        """Return the force [N] at mid-stroke of full strokes at constant speed and current, here in one long tick."""
        low, high = within.inputs["position"]
        run = self.at_full_strokes(0.5 * (high - low), self.valve.steady(current_A)).make_predictor(LONG_TICK)
        return run.tick(0.5 * (low + high), speed_m_s, current_A)

    @abstractmethod
    def at_full_strokes(self, half_m: float, setting: float) -> Self:
        """Return the model with the yield forces of its friction in the middle of strokes to +-`half_m` [m]."""

    def certify(self, within: OperatingRange) -> EnergyCertificate:
        """Return the proved bounds on |force| [N]; the force is held within its range, too."""
        most = max(map(abs, within.force_N))
        ranges = within.inputs, widen(within.inputs, self.reach)
        envelope, any_input = (min(self.bound_force(inputs), most) for inputs in ranges)
        return EnergyCertificate(envelope, any_input, ENERGY_CLAIM, self.method)

    @abstractmethod
    def bound_force(self, inputs: Ranges) -> float:
        """Return a bound on |force| [N] for inputs in their ranges, infinite if there is none."""


def yield_at_mid_stroke(stiffness_N_m: float, yield_N: float, half_m: float) -> float:
    """Return the force [N] of a yielding spring in the middle of strokes to +-`half_m` [m].

    It leaves an end with the force -min(yield, stiffness half): without yielding there, it is relaxed in the middle.
    """
    return min(max(stiffness_N_m * half_m - yield_N, 0.0), yield_N)
