"""Suspension stroke of a linear quarter vehicle on an ISO 8608 random road.

Both are computed in the frequency domain, so the road's spectrum is exact and the vehicle in steady state.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Array = NDArray[np.float64]
Spectrum = NDArray[np.complex128]

ROUGHNESS_M3 = {"A": 16e-6, "B": 64e-6, "C": 256e-6, "D": 1024e-6}  # [m³] at 0.1 cycles/m, ISO 8608 class means
REFERENCE_1_M = 0.1  # [1/m]
LONGEST_M = 100.0  # [m] longest wave of the road
HIGHEST_HZ = 50.0  # [Hz] the tyre's contact patch averages shorter waves


@dataclass(frozen=True)
class QuarterVehicle:
    """Rear end of a heavy motorcycle, at the damper's own lever ratio; its damping is constant."""

    sprung_kg: float = 145.0  # [kg]
    unsprung_kg: float = 17.0  # [kg]
    spring_N_m: float = 18e3  # [N/m]
    damping_Ns_m: float = 1400.0  # [N·s/m]
    tyre_N_m: float = 150e3  # [N/m]
    tyre_damping_Ns_m: float = 250.0  # [N·s/m]

    def stroke_response(self, frequency_Hz: Array) -> Spectrum:
        """Return suspension compression over road height, complex, at each frequency."""
        s = 2j * pi * frequency_Hz
        suspension, tyre = self.spring_N_m + self.damping_Ns_m * s, self.tyre_N_m + self.tyre_damping_Ns_m * s
        body = self.sprung_kg * s**2 + suspension
        wheel = self.unsprung_kg * s**2 + suspension + tyre
        wheel_height = tyre * body / (body * wheel - suspension**2)
        return np.asarray(wheel_height * (1.0 - suspension / body), dtype=np.complex128)


def road_stroke(
    road_class: str, vehicle_m_s: float, time_s: Array, rng: Generator, vehicle: QuarterVehicle | None = None
) -> Array:
    """Return the suspension stroke [m], positive in compression, at uniform times, shape (n,)."""
    frequency = np.fft.rfftfreq(len(time_s), time_s[1] - time_s[0])
    band = (frequency >= vehicle_m_s / LONGEST_M) & (frequency <= HIGHEST_HZ)
    wave = np.where(band, frequency, 1.0) / vehicle_m_s  # [1/m]
    density = np.where(band, ROUGHNESS_M3[road_class] * (wave / REFERENCE_1_M) ** -2 / vehicle_m_s, 0.0)  # [m²/Hz]
    complex_normal = rng.standard_normal(len(frequency)) + 1j * rng.standard_normal(len(frequency))
    step = frequency[1] - frequency[0]
    road = len(time_s) * np.sqrt(density * step) / 2.0 * complex_normal
    response = (vehicle or QuarterVehicle()).stroke_response(frequency)
    return np.asarray(np.fft.irfft(road * response, len(time_s)), dtype=np.float64)
