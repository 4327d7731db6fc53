"""An endless ISO 8608 road: white noise behind a first-order filter in distance, so that speed and class may change.

The profile's spectral density is G(n) = G(n0)·n0²/(n² + nc²), the standard's with waviness 2 above `nc` (1/100 m); the
tyre averages waves shorter than its contact patch by a second first-order filter in distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, pi, sqrt

import numpy as np
from numba import njit
from numpy.random import Generator

from ces_data.arrays import F
from ces_observer.fields import choice, quantity
from ces_rig.drive.strokes import QuarterVehicle
from ces_rig.errors import RigError

CLASSES = ("A", "B", "C", "D", "E", "F", "G", "H")
REFERENCE_1_M = 0.1  # n0 [cycles/m]
MAX_WAVE_M = 100.0  # [m] waves longer than this fade out
CONTACT_M = 0.1  # [m] length of the tyre's contact patch
BLOCK = 100  # grid points computed at once; a new speed or class waits for the next block


def roughness_m3(road_class: str) -> float:
    """Return the class's mean displacement spectral density G(n0) [m³] (ISO 8608: 16e-6 for A, four times each on)."""
    return float(16e-6 * 4.0 ** CLASSES.index(road_class))


AVERAGING = 2.8  # contact length over the length of a first-order filter with 3 dB attenuation at the same wave


class LiveRoad:
    """The road under the wheel at grid points every `interval_s` seconds; `road_class` and `speed_m_s` may be set."""

    def __init__(self, road_class: str, speed_m_s: float, interval_s: float, rng: Generator) -> None:
        self.road_class, self.speed_m_s = road_class, speed_m_s
        self._interval_s, self._rng = interval_s, rng
        self._state = np.zeros(2)  # profile and height under the tyre [m]
        self._block, self._next = np.empty(0), 0

    def heights(self, count: int) -> F:
        """Return the next `count` heights [m] under the tyre, at most BLOCK."""
        if self._next + count > len(self._block):
            self._block = np.concatenate([self._block[self._next :], self._roll_block()])
            self._next = 0
        self._next += count
        return self._block[self._next - count : self._next]

    def _roll_block(self) -> F:
        out = self._rng.standard_normal(BLOCK)
        roll(self._state, roughness_m3(self.road_class), self.speed_m_s * self._interval_s, out)
        return out


@njit(cache=True)
def roll(state: F, roughness: float, distance: float, out: F) -> None:
    """Convert normal random numbers in `out` to heights [m] under the tyre, `distance` [m] apart."""
    corner = 1.0 / MAX_WAVE_M
    decay = exp(-2.0 * pi * corner * distance)
    spread = sqrt(0.5 * pi * roughness * REFERENCE_1_M**2 / corner * (1.0 - decay * decay))
    left = exp(-AVERAGING * distance / CONTACT_M)
    for k in range(out.shape[0]):
        state[0] = decay * state[0] + spread * out[k]
        state[1] = state[0] + left * (state[1] - state[0])
        out[k] = state[1]


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


def as_kernel_numbers(vehicle: Vehicle, reach_m: float) -> F:
    """Return the kernel's numbers, shape (len(VehicleNumbers._fields),), for a damper whose ends are at ±`reach_m`.

    Raises RigError if the bump stop begins beyond the damper's end.
    """
    limit = reach_m - METAL_M
    if vehicle.stop_clearance_m >= limit:
        raise RigError(f"vehicle: stop_clearance_m {vehicle.stop_clearance_m:g} is not below the stroke {limit:g} m")
    v = vehicle
    chassis = (v.sprung_kg, v.unsprung_kg, v.spring_N_m, v.tyre_N_m, v.tyre_Ns_m)
    return np.array([*chassis, v.stop_clearance_m, v.stop_N_m, v.stop_m, limit])
