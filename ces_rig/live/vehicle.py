"""A quarter vehicle around the damper: body on a spring, wheel on a tyre, stops that end the stroke.

Everything counts from the vehicle at rest on level road with the damper at mid-stroke; heights, speeds and forces are
positive upwards, stroke and damper force in compression. Semi-implicit Euler at the damper's own fine step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ces_rig.descriptions import choice, quantity
from ces_rig.drive.quarter_vehicle import QuarterVehicle
from ces_rig.errors import RigError
from ces_rig.live.road import CLASSES

Array = NDArray[np.float64]

BODY, WHEEL, BODY_SPEED, WHEEL_SPEED, STROKE, STROKE_SPEED, FORCE, TYRE, BLOWS, MOTION_SIZE = range(10)
GRAVITY_M_S2 = 9.81
BLOW_M_S = 0.1  # [m/s] closing speed from which contact is a blow
METAL_M = 1e-3  # [m] before the damper's own end, where metal meets metal
REAR = QuarterVehicle()


@dataclass(frozen=True)
class Vehicle:
    """A quarter vehicle at the damper's own lever ratio, and the road it is driven on."""

    sprung_kg: float = quantity(REAR.sprung_kg, "kg", "mass of the body on this wheel", 10.0, 5e3)
    unsprung_kg: float = quantity(REAR.unsprung_kg, "kg", "mass of wheel, tyre and what moves with them", 1.0, 500.0)
    spring_N_m: float = quantity(REAR.spring_N_m, "N/m", "main spring", 100.0, 1e6)
    tyre_N_m: float = quantity(REAR.tyre_N_m, "N/m", "tyre, vertical stiffness", 1e3, 1e7)
    tyre_Ns_m: float = quantity(REAR.tyre_damping_Ns_m, "N·s/m", "tyre, vertical damping", 0.0, 1e5)
    stop_clearance_m: float = quantity(0.040, "m", "stroke, either way, where the bump stop begins", 1e-3, 0.5)
    stop_N_m: float = quantity(6e4, "N/m", "bump stop stiffness at first touch", 0.0, 1e7)
    stop_m: float = quantity(8e-3, "m", "bend that doubles the bump stop's secant stiffness", 1e-4, 0.1)
    road_class: str = choice("C", "ISO 8608 road class", CLASSES)
    speed_m_s: float = quantity(16.7, "m/s", "driving speed", 0.0, 80.0)


class VehicleNumbers(NamedTuple):
    """What the kernel needs of a vehicle: SI units."""

    sprung: float
    unsprung: float
    spring: float
    tyre: float
    tyre_damping: float
    stop_clearance: float
    stop: float
    stop_bend: float
    limit: float


def numbers_of(vehicle: Vehicle, reach_m: float) -> Array:
    """Return the kernel's numbers, shape (len(VehicleNumbers._fields),), on a damper whose ends are at ±`reach_m`.

    Raises RigError if the bump stop would begin beyond the damper's end.
    """
    limit = reach_m - METAL_M
    if vehicle.stop_clearance_m >= limit:
        raise RigError(f"vehicle: stop_clearance_m {vehicle.stop_clearance_m:g} is not below the stroke {limit:g} m")
    v = vehicle
    chassis = (v.sprung_kg, v.unsprung_kg, v.spring_N_m, v.tyre_N_m, v.tyre_Ns_m)
    return np.array([*chassis, v.stop_clearance_m, v.stop_N_m, v.stop_m, limit])


@njit(cache=True)
def vehicle_step(b: VehicleNumbers, m: Array, road: float, road_speed: float, h: float) -> None:
    """Advance the `motion` by `h` seconds under the damper force it holds; the tyre pushes, it never pulls."""
    bend = m[WHEEL] - m[BODY]
    up = b.spring * bend + stop_force(b, bend) + m[FORCE]
    weight = (b.sprung + b.unsprung) * GRAVITY_M_S2
    tyre = max(b.tyre * (road - m[WHEEL]) + b.tyre_damping * (road_speed - m[WHEEL_SPEED]), -weight)
    m[BODY_SPEED] += h * up / b.sprung
    m[WHEEL_SPEED] += h * (tyre - up) / b.unsprung
    m[BODY] += h * m[BODY_SPEED]
    m[WHEEL] += h * m[WHEEL_SPEED]
    end_of_stroke(b, m)
    m[STROKE] = m[WHEEL] - m[BODY]
    m[STROKE_SPEED] = m[WHEEL_SPEED] - m[BODY_SPEED]
    m[TYRE] = weight + tyre


@njit(cache=True)
def stop_force(b: VehicleNumbers, bend: float) -> float:
    """Return the bump stop's force [N] at a stroke [m]; its stiffness grows with the square of its bend."""
    into = abs(bend) - b.stop_clearance
    if into <= 0.0:
        return 0.0
    force = b.stop * into * (1.0 + (into / b.stop_bend) ** 2)
    return force if bend > 0.0 else -force


@njit(cache=True)
def end_of_stroke(b: VehicleNumbers, m: Array) -> None:
    """Where metal meets metal, let both masses go on at their common speed: a plastic blow that keeps momentum."""
    bend = m[WHEEL] - m[BODY]
    excess = bend - b.limit if bend > 0.0 else bend + b.limit
    if abs(bend) <= b.limit:
        return
    whole = b.sprung + b.unsprung
    m[BODY] += excess * b.unsprung / whole
    m[WHEEL] -= excess * b.sprung / whole
    closing = m[WHEEL_SPEED] - m[BODY_SPEED] if bend > 0.0 else m[BODY_SPEED] - m[WHEEL_SPEED]
    if closing > 0.0:
        common = (b.sprung * m[BODY_SPEED] + b.unsprung * m[WHEEL_SPEED]) / whole
        m[BODY_SPEED] = m[WHEEL_SPEED] = common
        m[BLOWS] += 1.0 if closing > BLOW_M_S else 0.0
