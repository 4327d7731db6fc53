"""A magneto-rheological (MR) damper: parameters of Spencer's modified Bouc–Wen model and of the parts around it.

The model is that of B. F. Spencer et al., J. Eng. Mech. 123 (1997), with normalised hysteresis (|z| <= 1), surrounded
by the spring of the fluid, gas, seals, stops, a mass and a bushing. `kernel.py` holds the equations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ces_observer.records import quantity
from ces_rig.dampers.model import LumpedDamper


@dataclass(frozen=True)
class BoucWen(LumpedDamper):
    """An MR damper; raises RigError if a number is out of range."""

    kind: ClassVar[str] = "bouc_wen"
    current_A: ClassVar[tuple[float, float]] = (0.1, 1.6)

    yield_N: float = quantity(70.0, "N", "yield force of the fluid without field", 0.0, 1e5)
    yield_N_A: float = quantity(650.0, "N/A", "growth of the yield force with the field", 0.0, 1e5)
    saturation_A: float = quantity(1.6, "A", "field at which that growth saturates (tanh)", 0.01, 100.0)
    yield_m: float = quantity(5e-4, "m", "displacement over which the fluid yields", 1e-5, 0.1)
    sharpness: float = quantity(2.0, "1", "exponent n of the Bouc–Wen law", 1.0, 10.0)
    unloading: float = quantity(0.6, "1", "share gamma of the Bouc–Wen law", 0.5, 1.0)
    viscous_Ns_m: float = quantity(600.0, "N·s/m", "viscous damping c0 without field", 1.0, 1e6)
    viscous_Ns_mA: float = quantity(350.0, "N·s/(m·A)", "growth of the viscous damping with the field", 0.0, 1e6)
    series_Ns_m: float = quantity(2.5e4, "N·s/m", "dashpot c1 in series", 100.0, 1e8)
    inner_N_m: float = quantity(900.0, "N/m", "spring k0 across the fluid", 0.0, 1e7)
    fluid_N_m: float = quantity(1.2e7, "N/m", "stiffness of the fluid and its chambers", 1e4, 1e10)
    fluid_rebound: float = quantity(1.0, "1", "ratio of that stiffness in rebound to compression", 0.1, 10.0)
    bubbles_m: float = quantity(0.0, "m", "travel in which bubbles are squeezed out", 0.0, 0.02)
    field_s: float = quantity(4e-3, "s", "time constant of the fluid's response to the field", 0.0, 0.5)
    eddy_s: float = quantity(0.0, "s", "further time constant, of eddy currents", 0.0, 0.5)
    remanence_A: float = quantity(0.0, "A", "half width of the magnetic loop", 0.0, 2.0)
    remanence_bend_A: float = quantity(0.15, "A", "change of current that crosses 63 % of the loop", 1e-3, 10.0)
    gas_Pa: float = quantity(1.5e6, "Pa", "accumulator pressure at mid-stroke", 1e4, 1e7)
    gas_m3: float = quantity(6e-5, "m³", "accumulator gas volume at mid-stroke", 1e-6, 1e-2)
    gas_exponent: float = quantity(1.3, "1", "polytropic exponent", 1.0, 1.67)
    rod_m2: float = quantity(1.2e-4, "m²", "rod area", 1e-6, 1e-2)
    seal_N: float = quantity(4.0, "N", "sliding friction of the seals", 0.0, 5e3)
    seal_static: float = quantity(1.2, "1", "ratio of breakaway to sliding friction", 1.0, 5.0)
    stribeck_m_s: float = quantity(0.015, "m/s", "Stribeck speed", 1e-4, 1.0)
    bristle_N_m: float = quantity(2e5, "N/m", "presliding stiffness", 1e2, 1e8)
    bristle_Ns_m: float = quantity(80.0, "N·s/m", "presliding damping", 0.0, 1e5)
    mass_kg: float = quantity(0.35, "kg", "rod and piston, beyond the bushing", 0.05, 20.0)
    stop_N_m: float = quantity(2e5, "N/m", "stiffness of the stop", 0.0, 1e8)
    fade_yield_1_K: float = quantity(0.0, "1/K", "relative fall of the yield force with temperature", 0.0, 0.1)
    fade_viscous_1_K: float = quantity(0.0, "1/K", "relative fall of the viscous damping", 0.0, 0.1)
