"""A mono-tube damper with a floating piston, shim stacks for each direction and a piloted spool beside them.

Shim stacks behind ports, bleed and gas are those of J. C. Dixon, The Shock Absorber Handbook (2007), chapters 5 to 7;
rod-side compressibility and cavitation follow H. H. Lang, A Study of the Characteristics of Automotive Hydraulic
Dampers (1977); seals follow P. R. Dahl, AIAA Journal 14 (1976). `kernel.py` holds the equations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ces_observer.fields import quantity
from ces_rig.dampers.model import LumpedDamper


@dataclass(frozen=True)
class Monotube(LumpedDamper):
    """A mono-tube damper; raises RigError if a number is out of range. Forces are those on the annulus."""

    kind: ClassVar[str] = "monotube"
    current_A: ClassVar[tuple[float, float]] = (0.2, 1.6)

    annulus_m2: float = quantity(1.2e-3, "m²", "area of the piston on the rod side", 1e-5, 1e-1)
    bleed: float = quantity(2.2e-3, "m/(s·√N)", "bleed orifice, always open", 0.0, 1.0)
    compression_N: float = quantity(70.0, "N", "preload of the compression stack", 0.0, 1e5)
    compression_shim: float = quantity(3.2e-5, "m/(s·N·√N)", "opening of that stack", 1e-7, 1e-2)
    compression_port: float = quantity(0.06, "m/(s·√N)", "port in series with that stack", 1e-4, 10.0)
    rebound_N: float = quantity(160.0, "N", "preload of the rebound stack", 0.0, 1e5)
    rebound_shim: float = quantity(1.3e-5, "m/(s·N·√N)", "opening of that stack", 1e-7, 1e-2)
    rebound_port: float = quantity(0.04, "m/(s·√N)", "port in series with that stack", 1e-4, 10.0)
    edge_N: float = quantity(25.0, "N", "softness of the stacks' lifting", 0.1, 1e4)
    pilot_N: float = quantity(60.0, "N", "force at which the spool opens without current, in rebound", 0.0, 1e5)
    pilot_N_A2: float = quantity(700.0, "N/A²", "growth of that force with the square of the flux", 0.0, 1e6)
    pilot_compression: float = quantity(0.6, "1", "ratio of that force in compression to rebound", 0.05, 10.0)
    saturation_A: float = quantity(1.5, "A", "flux at which the magnet saturates", 0.01, 100.0)
    pilot_s: float = quantity(2e-3, "s", "time constant of the pilot's chamber", 0.0, 0.5)
    spool_port: float = quantity(0.035, "m/(s·√N)", "the spool's port, open", 0.0, 10.0)
    spool_band_N: float = quantity(300.0, "N", "force that opens the spool beyond the pilot's", 1.0, 1e5)
    spool_open_s: float = quantity(3e-3, "s", "time constant of the opening spool", 1e-4, 0.5)
    spool_close_s: float = quantity(5e-3, "s", "time constant of the closing spool", 1e-4, 0.5)
    coil_s: float = quantity(2e-3, "s", "coil and driver time constant", 0.0, 0.5)
    eddy_s: float = quantity(1.5e-3, "s", "time constant of eddy currents", 0.0, 0.5)
    loop_A: float = quantity(0.0, "A", "half width of the magnetic loop", 0.0, 2.0)
    oil_N_m: float = quantity(1.9e7, "N/m", "stiffness of the oil on the rod side at mid-stroke", 1e4, 1e10)
    column_m: float = quantity(0.09, "m", "length of that oil at mid-stroke", 0.065, 1.0)
    air_m: float = quantity(1e-5, "m", "air in it, as travel", 1e-7, 0.02)
    gas_Pa: float = quantity(1.8e6, "Pa", "gas pressure at mid-stroke", 1e4, 1e7)
    gas_m3: float = quantity(4e-5, "m³", "gas volume at mid-stroke", 1e-6, 1e-2)
    gas_exponent: float = quantity(1.3, "1", "polytropic exponent", 1.0, 1.67)
    rod_m2: float = quantity(1.5e-4, "m²", "rod area", 1e-6, 1e-2)
    clearance_m_sN: float = quantity(2e-6, "m/(s·N)", "laminar leakage past the piston ring", 0.0, 1.0)
    relief_N: float = quantity(1e5, "N", "force at which the relief valve opens", 1.0, 1e6)
    relief_band_N: float = quantity(150.0, "N", "force that opens it fully", 1.0, 1e5)
    relief_port: float = quantity(0.05, "m/(s·√N)", "its port", 0.0, 10.0)
    seal_N: float = quantity(5.0, "N", "sliding friction of the seals", 0.0, 5e3)
    seal_rise: float = quantity(0.15, "1", "relative rise of friction at standstill", 0.0, 5.0)
    seal_m_s: float = quantity(0.02, "m/s", "speed at which half of that rise has gone", 1e-4, 1.0)
    seal_m: float = quantity(5e-5, "m", "presliding travel", 1e-6, 0.1)
    seal_Ns_m: float = quantity(15.0, "N·s/m", "viscous friction of the seals", 0.0, 1e5)
    mass_kg: float = quantity(0.45, "kg", "rod and piston, beyond the bushing", 0.05, 20.0)
    mount_N_m: float = quantity(2e7, "N/m", "stiffness of the bushing at first", 1e4, 1e9)
    mount_m: float = quantity(0.1, "m", "deflection that doubles it", 1e-5, 10.0)
    mount_Ns_m: float = quantity(3.5e3, "N·s/m", "damping of the bushing", 0.0, 1e6)
    play_edge_m: float = quantity(1e-5, "m", "roundness of the edges of the play", 1e-7, 1e-3)
    stop_clearance_m: float = quantity(0.055, "m", "stroke, either way, where the stop begins", 1e-3, 0.5)
    stop_N_m: float = quantity(8e4, "N/m", "stiffness of the stop at first contact", 0.0, 1e8)
    stop_m: float = quantity(0.03, "m", "deflection at which the stop would lock", 1e-3, 1.0)
    thinning_1_K: float = quantity(0.0, "1/K", "relative fall of the oil's viscosity with temperature", 0.0, 0.1)
    discharge_share: float = quantity(0.5, "1", "share of it by which orifices pass more", 0.0, 2.0)
    heat_J_K: float = quantity(2500.0, "J/K", "heat capacity", 5.0, 1e6)
    heat_loss_W_K: float = quantity(3.0, "W/K", "heat loss", 0.0, 1e4)
    groove_m_Ns: float = quantity(0.0, "m/(s·N)", "bypass in a groove of the wall", 0.0, 1e-2)
    foaming_1_J: float = quantity(0.0, "m/J", "growth of the air's travel with the absorbed energy", 0.0, 1e-3)
    stick_N: float = quantity(0.0, "N", "additional force that lifts closed shims off their seats", 0.0, 1e5)
    closing_s: float = quantity(0.0, "s", "time in which an open stack closes after the force has reversed", 0.0, 10.0)
