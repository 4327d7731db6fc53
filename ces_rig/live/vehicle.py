"""The vehicle of a live rig: its parameters, and the numbers that its kernel needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_rig.descriptions import choice, quantity
from ces_rig.drive.quarter_vehicle import QuarterVehicle
from ces_rig.errors import RigError
from ces_rig.live.road import CLASSES

Array = NDArray[np.float64]

METAL_M = 1e-3  # [m] distance of the metal stops from the damper's end
REAR = QuarterVehicle()


@dataclass(frozen=True)
class Vehicle:
    """A quarter vehicle at the damper's own lever ratio, and its road."""

    sprung_kg: float = quantity(REAR.sprung_kg, "kg", "mass of the body on this wheel", 10.0, 5e3)
    unsprung_kg: float = quantity(REAR.unsprung_kg, "kg", "mass of wheel, tyre and parts moving with them", 1.0, 500.0)
    spring_N_m: float = quantity(REAR.spring_N_m, "N/m", "main spring", 100.0, 1e6)
    tyre_N_m: float = quantity(REAR.tyre_N_m, "N/m", "tyre, vertical stiffness", 1e3, 1e7)
    tyre_Ns_m: float = quantity(REAR.tyre_damping_Ns_m, "N·s/m", "tyre, vertical damping", 0.0, 1e5)
    stop_clearance_m: float = quantity(0.040, "m", "stroke, either way, where the bump stop begins", 1e-3, 0.5)
    stop_N_m: float = quantity(6e4, "N/m", "bump stop stiffness at first contact", 0.0, 1e7)
    stop_m: float = quantity(8e-3, "m", "deflection that doubles the bump stop's secant stiffness", 1e-4, 0.1)
    road_class: str = choice("C", "ISO 8608 road class", CLASSES)
    speed_m_s: float = quantity(16.7, "m/s", "driving speed", 0.0, 80.0)


def as_kernel_numbers(vehicle: Vehicle, reach_m: float) -> Array:
    """Return the kernel's numbers, shape (len(VehicleNumbers._fields),), for a damper whose ends are at ±`reach_m`.

    Raises RigError if the bump stop begins beyond the damper's end.
    """
    limit = reach_m - METAL_M
    if vehicle.stop_clearance_m >= limit:
        raise RigError(f"vehicle: stop_clearance_m {vehicle.stop_clearance_m:g} is not below the stroke {limit:g} m")
    v = vehicle
    chassis = (v.sprung_kg, v.unsprung_kg, v.spring_N_m, v.tyre_N_m, v.tyre_Ns_m)
    return np.array([*chassis, v.stop_clearance_m, v.stop_N_m, v.stop_m, limit])
