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
from typing import Self

from ces_observer.flat import ArrayLayout
from ces_observer.limits import FileLimits, NumberLimits
from ces_observer.proof.intervals import up
from ces_observer.records import bounded, items, part
from ces_observer.structures.curves import IncreasingCurve, check_over_stroke, interpolate, nodes
from ces_observer.structures.structure import INPUTS, OperatingRange, Range, Ranges
from ces_observer.tick import hydraulic as tick
from ces_observer.tick import valve


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
