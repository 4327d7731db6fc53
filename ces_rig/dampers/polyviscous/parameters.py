"""An electro-rheological (ER) twin-tube damper of Maxwell type: bleed, knee valves and shear-thinning oil on a spring.

Its "current" is the field's voltage in kV. Every law differs from those of the other dampers: motion follows from
force (Eyring's shear thinning beside knee valves that differ by direction), the seals are Jenkins elements, the bushing
relaxes, the gas exchanges heat. `kernel.py` holds the equations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ces_observer.fields import quantity
from ces_rig.dampers.model import LumpedDamper


@dataclass(frozen=True)
class Polyviscous(LumpedDamper):
    """An ER damper; raises RigError if a number is out of range. `_A` in names means the input's unit (kV)."""

    kind: ClassVar[str] = "calibration"
    current_A: ClassVar[tuple[float, float]] = (0.5, 4.0)

    bleed_Ns_m: float = quantity(7000.0, "N·s/m", "damping of the bleed at small force", 100.0, 1e7)
    thinning_N: float = quantity(1400.0, "N", "Eyring force beyond which the oil in the bleed thins", 50.0, 1e6)
    knee_N: float = quantity(120.0, "N", "force at which the valves open in compression without field", 1.0, 1e5)
    knee_N_A2: float = quantity(55.0, "N/A²", "growth of the knee force with the square of the field", 0.0, 1e5)
    knee_rebound: float = quantity(1.7, "1", "ratio of the knee force in rebound to compression", 0.1, 10.0)
    knee_width_N: float = quantity(45.0, "N", "softness of the knee", 1.0, 1e4)
    beyond_Ns_m: float = quantity(750.0, "N·s/m", "damping beyond the knee in compression", 10.0, 1e6)
    beyond_rebound: float = quantity(1.6, "1", "ratio of that damping in rebound to compression", 0.1, 10.0)
    oil_N_m: float = quantity(9e6, "N/m", "stiffness of oil and tubes", 1e4, 1e10)
    air_m: float = quantity(1e-5, "m", "travel that compresses the air", 0.0, 0.02)
    air_N: float = quantity(250.0, "N", "force that compresses half of it", 1.0, 1e5)
    foot_m_s: float = quantity(
        10.0, "m/s", "rebound speed beyond which the foot valve cannot fill the chamber", 0.01, 100.0
    )
    bypass_m_sN: float = quantity(0.0, "m/(s·√N)", "turbulent leakage per square root of force", 0.0, 1.0)
    relief_N: float = quantity(1e5, "N", "force at which the relief valve lifts", 1.0, 1e6)
    relief_Ns_m: float = quantity(250.0, "N·s/m", "damping when the valve has lifted", 1.0, 1e6)
    relief_s: float = quantity(1.5e-3, "s", "time constant of the lift", 1e-4, 0.5)
    coil_s: float = quantity(1.5e-3, "s", "amplifier time constant", 0.0, 0.5)
    field_s: float = quantity(2.5e-3, "s", "each of two equal lags of the fluid's response", 0.0, 0.5)
    delay_s: float = quantity(0.0, "s", "dead time of the amplifier's output stage", 0.0, 0.5)
    loop_A: float = quantity(0.0, "A", "half width of the polarisation loop", 0.0, 5.0)
    gas_Pa: float = quantity(4e5, "Pa", "gas pressure at mid-stroke", 1e4, 1e7)
    gas_m3: float = quantity(9e-5, "m³", "gas volume at mid-stroke", 1e-6, 1e-2)
    gas_s: float = quantity(4.0, "s", "time in which the gas loses its heat of compression", 1e-2, 1e4)
    rod_m2: float = quantity(2e-4, "m²", "rod area", 1e-6, 1e-2)
    seal_N: float = quantity(5.0, "N", "sliding friction of the seals", 0.0, 5e3)
    seal_m: float = quantity(1e-4, "m", "presliding travel of the seals", 1e-6, 0.1)
    seal_rise: float = quantity(0.1, "1", "relative rise of friction at standstill", 0.0, 5.0)
    seal_m_s: float = quantity(0.02, "m/s", "speed at which 63 % of that rise has gone", 1e-4, 1.0)
    mass_kg: float = quantity(0.5, "kg", "rod and piston, beyond the bushing", 0.05, 20.0)
    mount_N_m: float = quantity(2e7, "N/m", "long-time stiffness of the bushing", 1e4, 1e9)
    mount_stiffening: float = quantity(0.0, "1/mm²", "relative growth of stiffness with deflection squared", 0.0, 100.0)
    mount_Ns_m: float = quantity(4e3, "N·s/m", "damping of the bushing", 0.0, 1e6)
    mount_relaxing: float = quantity(0.3, "1", "ratio of relaxing to permanent stiffness", 0.0, 10.0)
    mount_s: float = quantity(5e-3, "s", "relaxation time", 1e-4, 10.0)
    play_edge_m: float = quantity(1e-5, "m", "softness of the edges of the play", 1e-7, 1e-3)
    stop_clearance_m: float = quantity(0.055, "m", "stroke, either way, where the rubber begins", 1e-3, 0.5)
    stop_N_m: float = quantity(5e4, "N/m", "stiffness of the rubber at first contact", 0.0, 1e8)
    stop_m: float = quantity(5e-3, "m", "bend that makes it e times stiffer", 1e-4, 1.0)
    fade_1_K: float = quantity(0.0, "1/K", "relative fall of all damping with temperature", 0.0, 0.1)
    heat_J_K: float = quantity(3000.0, "J/K", "heat capacity", 5.0, 1e6)
    heat_loss_W_K: float = quantity(2.0, "W/K", "heat loss", 0.0, 1e4)
    groove_m_Ns: float = quantity(0.0, "m/(s·N)", "bypass in a groove of the wall", 0.0, 1e-2)
    foaming_1_J: float = quantity(0.0, "m/J", "growth of the air's travel with the absorbed energy", 0.0, 1e-3)
    stick_N: float = quantity(0.0, "N", "additional force that lifts the closed valves off their seats", 0.0, 1e5)
    closing_s: float = quantity(0.0, "s", "time in which an open valve closes after the force has reversed", 0.0, 10.0)
