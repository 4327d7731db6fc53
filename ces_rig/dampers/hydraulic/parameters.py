"""Parameters of the hydraulic CES damper, each with unit, plausible range and meaning; loadable from YAML.

All units are SI. The equations are in `kernel.py`. Effective areas include the discharge coefficient.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass, field
from math import pi
from pathlib import Path
from typing import ClassVar

import numpy as np

from ces_data.arrays import F
from ces_data.config_file import read_yaml_mapping
from ces_observer.records import quantity, read_record, walk_record
from ces_rig.dampers.hydraulic.kernel import Numbers
from ces_rig.dampers.model import RigDamper, replace_numbers
from ces_rig.errors import RigError


@dataclass(frozen=True)
class Body:
    """Cylinder, rod and the volumes at mid-stroke."""

    bore_m: float = quantity(0.036, "m", "cylinder bore", 0.01, 0.1)
    rod_m: float = quantity(0.018, "m", "rod diameter", 0.004, 0.06)
    half_stroke_m: float = quantity(0.060, "m", "travel from mid-stroke to either end", 0.005, 0.5)
    compression_dead_m3: float = quantity(10e-6, "m³", "oil left in the compression chamber at full bump", 1e-6, 1e-3)
    rebound_dead_m3: float = quantity(22e-6, "m³", "oil left in rebound chamber, passage to the valve", 1e-6, 1e-3)
    moving_mass_kg: float = quantity(0.6, "kg", "rod, piston and bushing eye beyond the bushing", 0.05, 20.0)
    bump_clearance_m: float = quantity(0.050, "m", "stroke, either way, where the bump stop begins", 0.001, 0.5)
    bump_stiffness_N_m: float = quantity(4e5, "N/m", "bump stop stiffness", 0.0, 1e8)
    bump_progression_1_m: float = quantity(0.0, "1/m", "relative growth of stiffness with deflection", 0.0, 1e4)

    def __post_init__(self) -> None:
        if self.rod_m >= self.bore_m:
            raise RigError(f"rod_m {self.rod_m:g} is not smaller than bore_m {self.bore_m:g}")


@dataclass(frozen=True)
class Oil:
    """Damper oil with entrained air; pressures are absolute."""

    density_kg_m3: float = quantity(860.0, "kg/m³", "density at atmospheric pressure", 500.0, 1500.0)
    bulk_modulus_Pa: float = quantity(1.4e9, "Pa", "isentropic bulk modulus without air", 1e8, 5e9)
    air_fraction: float = quantity(0.012, "1", "entrained air by volume at atmospheric pressure", 0.0, 0.3)
    air_exponent: float = quantity(1.3, "1", "polytropic exponent of the air bubbles", 1.0, 1.67)
    vapour_pressure_Pa: float = quantity(3e3, "Pa", "pressure at which oil vapour forms", 500.0, 9e4)
    viscosity_fall_1_K: float = quantity(0.022, "1/K", "relative fall of viscosity with temperature", 0.0, 0.1)
    discharge_rise_1_K: float = quantity(0.0, "1/K", "relative rise of all orifices' flow with temperature", 0.0, 0.1)


@dataclass(frozen=True)
class CheckValve:
    """Spring-loaded plate or shim stack: opens over a band of pressure drop, with its own lag."""

    area_m2: float = quantity(30e-6, "m²", "effective flow area when fully open", 1e-8, 1e-3)
    cracking_Pa: float = quantity(5e4, "Pa", "pressure drop at which it begins to open", 0.0, 1e7)
    full_open_Pa: float = quantity(6e5, "Pa", "pressure drop at which it is fully open", 1e3, 5e7)
    opening_s: float = quantity(0.6e-3, "s", "time constant of opening", 1e-4, 0.1)
    closing_s: float = quantity(1.6e-3, "s", "time constant of closing (backflow meanwhile)", 1e-4, 0.1)

    def __post_init__(self) -> None:
        if self.full_open_Pa <= self.cracking_Pa:
            raise RigError(f"full_open_Pa {self.full_open_Pa:g} is not above cracking_Pa")


@dataclass(frozen=True)
class Piston:
    """Passages across the piston."""

    compression: CheckValve = field(default_factory=CheckValve)
    bleed_area_m2: float = quantity(0.5e-6, "m²", "bleed orifice, always open", 0.0, 1e-4)
    leakage_m3_sPa: float = quantity(1.2e-12, "m³/(s·Pa)", "laminar leakage past the ring at 40 °C", 0.0, 1e-9)
    blow_off_Pa: float = quantity(6.5e6, "Pa", "rebound blow-off shims: drop at which they open", 1e5, 1e8)
    blow_off_area_m2: float = quantity(12e-6, "m²", "blow-off effective area when fully open", 0.0, 1e-3)
    blow_off_band_Pa: float = quantity(3e6, "Pa", "drop beyond cracking at which blow-off is fully open", 1e4, 1e8)


@dataclass(frozen=True)
class TopChecks:
    """Check valves in the top that fill the chambers from the reservoir."""

    compression: CheckValve = field(default_factory=lambda: CheckValve(60e-6, 6e3, 4e4, 0.8e-3, 2.0e-3))
    rebound: CheckValve = field(default_factory=lambda: CheckValve(20e-6, 6e3, 4e4, 0.8e-3, 1.5e-3))


@dataclass(frozen=True)
class CesValve:
    """Pilot-controlled valve from rebound chamber to reservoir: current sets the drop at which its poppet opens."""

    area_m2: float = quantity(18e-6, "m²", "main poppet, effective area when fully open", 1e-7, 1e-3)
    band_Pa: float = quantity(2.2e6, "Pa", "drop beyond cracking at which the poppet is fully open", 1e4, 1e8)
    poppet_s: float = quantity(0.35e-3, "s", "time constant of the main poppet", 1e-4, 0.1)
    pilot_area_m2: float = quantity(0.35e-6, "m²", "effective area of the pilot flow, always open", 0.0, 1e-4)
    cracking_low_Pa: float = quantity(0.30e6, "Pa", "cracking drop at current_low_A, without the bend", 0.0, 1e8)
    cracking_high_Pa: float = quantity(3.9e6, "Pa", "cracking drop at current_high_A, without the bend", 0.0, 1e8)
    current_low_A: float = quantity(0.29, "A", "lower end of the working range", 0.0, 10.0)
    current_high_A: float = quantity(0.70, "A", "upper end of the working range", 0.01, 20.0)
    saturation_A: float = quantity(0.03, "A", "width of the bends at both ends of it", 1e-3, 1.0)
    allowed_low_A: float = quantity(0.20, "A", "lowest current the valve answers to", 0.0, 10.0)
    allowed_high_A: float = quantity(1.60, "A", "highest current the valve answers to", 0.01, 20.0)
    solenoid_s: float = quantity(2.5e-3, "s", "coil and driver time constant (L/R)", 0.0, 0.1)
    pilot_rise_s: float = quantity(11e-3, "s", "pilot time constant while the cracking drop rises", 1e-4, 0.2)
    pilot_fall_s: float = quantity(7e-3, "s", "pilot time constant while it falls", 1e-4, 0.2)
    hysteresis_A: float = quantity(0.015, "A", "half width of the magnetic loop of the pilot stage", 0.0, 0.2)

    def __post_init__(self) -> None:
        if self.current_high_A <= self.current_low_A:
            raise RigError("current_high_A is not above current_low_A")
        if self.allowed_low_A > self.current_low_A or self.allowed_high_A < self.current_high_A:
            allowed = f"the allowed range {self.allowed_low_A:g} to {self.allowed_high_A:g} A"
            working = f"the working range {self.current_low_A:g} to {self.current_high_A:g} A"
            raise RigError(f"{allowed} does not contain {working}; set allowed_low_A, allowed_high_A")
        if self.cracking_high_Pa < self.cracking_low_Pa:
            raise RigError("cracking_high_Pa is below cracking_low_Pa")


@dataclass(frozen=True)
class Reservoir:
    """Gas behind a floating piston; pressure absolute."""

    pressure_Pa: float = quantity(1.0e6, "Pa", "gas pressure at mid-stroke", 2e4, 1e7)
    gas_m3: float = quantity(60e-6, "m³", "gas volume at mid-stroke", 1e-6, 1e-2)
    oil_m3: float = quantity(60e-6, "m³", "oil in the reservoir at mid-stroke", 1e-6, 1e-2)
    exponent: float = quantity(1.3, "1", "polytropic exponent of the gas", 1.0, 1.67)


@dataclass(frozen=True)
class Seal:
    """Rod and piston seals: LuGre friction, which grows with the pressure in the rebound chamber."""

    coulomb_N: float = quantity(28.0, "N", "sliding friction without pressure", 0.0, 5e3)
    static_N: float = quantity(45.0, "N", "breakaway friction without pressure", 0.0, 5e3)
    pressure_1_Pa: float = quantity(1.2e-7, "1/Pa", "relative growth of both with gauge pressure", 0.0, 1e-5)
    stribeck_m_s: float = quantity(0.015, "m/s", "Stribeck speed", 1e-4, 1.0)
    bristle_N_m: float = quantity(3e5, "N/m", "presliding stiffness", 1e2, 1e8)
    bristle_Ns_m: float = quantity(150.0, "N·s/m", "presliding damping", 0.0, 1e5)
    viscous_Ns_m: float = quantity(25.0, "N·s/m", "viscous friction, oil at 40 °C", 0.0, 1e4)

    def __post_init__(self) -> None:
        if self.static_N < self.coulomb_N:
            raise RigError(f"static_N {self.static_N:g} is below coulomb_N {self.coulomb_N:g}")


@dataclass(frozen=True)
class Mount:
    """Bushing between the rig's actuator, where position and force are measured, and the rod."""

    stiffness_N_m: float = quantity(3.0e6, "N/m", "stiffness of the bushing", 1e4, 1e9)
    damping_Ns_m: float = quantity(700.0, "N·s/m", "damping of the bushing", 0.0, 1e6)
    play_m: float = quantity(0.0, "m", "free play, end to end", 0.0, 0.02)


@dataclass(frozen=True)
class Heat:
    """Oil and body as one heat capacity, warmed by the dissipated power."""

    start_degC: float = quantity(40.0, "°C", "initial temperature", -40.0, 150.0)
    ambient_degC: float = quantity(22.0, "°C", "ambient temperature", -40.0, 60.0)
    capacity_J_K: float = quantity(1500.0, "J/K", "heat capacity of oil and body", 10.0, 1e6)
    loss_W_K: float = quantity(4.0, "W/K", "heat loss to the surroundings", 0.0, 1e4)


@dataclass(frozen=True)
class Damper:
    """A hydraulic CES damper; raises RigError if its parts do not fit together."""

    body: Body = field(default_factory=Body)
    oil: Oil = field(default_factory=Oil)
    piston: Piston = field(default_factory=Piston)
    top_checks: TopChecks = field(default_factory=TopChecks)
    ces_valve: CesValve = field(default_factory=CesValve)
    reservoir: Reservoir = field(default_factory=Reservoir)
    seal: Seal = field(default_factory=Seal)
    mount: Mount = field(default_factory=Mount)
    heat: Heat = field(default_factory=Heat)

    def __post_init__(self) -> None:
        gas_m3 = self.reservoir.gas_m3
        if gas_m3 <= self.rod_area_m2 * self.body.half_stroke_m:
            raise RigError(f"reservoir: gas_m3 {gas_m3:g} cannot take up the rod's volume; enlarge it")

    @property
    def piston_area_m2(self) -> float:
        """Piston area on the side of the compression chamber."""
        return pi / 4 * self.body.bore_m**2

    @property
    def rod_area_m2(self) -> float:
        """Area of the rod."""
        return pi / 4 * self.body.rod_m**2

    @property
    def annulus_area_m2(self) -> float:
        """Piston area on the side of the rebound chamber."""
        return self.piston_area_m2 - self.rod_area_m2


def parse_damper(mapping: object, where: str) -> Damper:
    """Return the damper of a `mapping` (sections of `Damper`; missing keys keep their defaults); raises RigError."""
    return read_record(Damper, mapping, where, RigError, Damper())


def load_damper(path: Path) -> Damper:
    """Return the damper described in the YAML file `path`; raises RigError."""
    return parse_damper(read_yaml_mapping(path, "a damper description", error=RigError), str(path))


def coefficients(damper: Damper) -> Numbers:
    """Return the kernel's coefficients of `damper`; the fields of valves, seal and mount are in the kernel's order."""
    b, oil, piston, gas, heat = damper.body, damper.oil, damper.piston, damper.reservoir, damper.heat
    numbers = (
        damper.piston_area_m2, damper.annulus_area_m2, damper.rod_area_m2,
        damper.piston_area_m2 * b.half_stroke_m + b.compression_dead_m3,
        damper.annulus_area_m2 * b.half_stroke_m + b.rebound_dead_m3,
        b.moving_mass_kg, b.bump_clearance_m, b.bump_stiffness_N_m, b.bump_progression_1_m,
        oil.density_kg_m3, oil.bulk_modulus_Pa, oil.air_fraction, 1.0 / oil.air_exponent, oil.vapour_pressure_Pa,
        oil.viscosity_fall_1_K, oil.discharge_rise_1_K,
        *astuple(piston.compression), piston.bleed_area_m2, piston.leakage_m3_sPa,
        piston.blow_off_Pa, piston.blow_off_area_m2, piston.blow_off_band_Pa,
        *astuple(damper.top_checks.compression), *astuple(damper.top_checks.rebound), *astuple(damper.ces_valve),
        gas.pressure_Pa, gas.gas_m3, gas.gas_m3 + gas.oil_m3, 1.0 / gas.exponent,
        *astuple(damper.seal), *astuple(damper.mount),
        heat.ambient_degC, heat.capacity_J_K, heat.loss_W_K, heat.start_degC,
    )  # fmt: skip
    return Numbers(*numbers)


MAX_AIR_FRACTION = 0.25
FOAM_EVERY_S = 5e-3  # [s] between updates of a growing air content
PATHS = frozenset(path for path, *_ in walk_record(Damper()))
AIR = Numbers._fields.index("air")


@dataclass(frozen=True)
class HydraulicDamper(RigDamper):
    """The damper, with `extras` (coefficients without a parameter) and the growth of its air content per joule."""

    kind: ClassVar[str] = "hydraulic"
    coil_path: ClassVar[str] = "ces_valve.solenoid_s"

    damper: Damper
    extras: Mapping[str, float] = field(default_factory=dict)
    foaming_1_J: float = 0.0

    @property
    def current_A(self) -> tuple[float, float]:
        """The working range [A] of the current, which experiments use."""
        return self.damper.ces_valve.current_low_A, self.damper.ces_valve.current_high_A

    @property
    def allowed_A(self) -> tuple[float, float]:
        """The range [A] of currents that the valve answers to; a driver clips commands to it."""
        return self.damper.ces_valve.allowed_low_A, self.damper.ces_valve.allowed_high_A

    @property
    def reach_m(self) -> float:
        """Travel [m] from mid-stroke to either end."""
        return self.damper.body.half_stroke_m

    def coefficients(self) -> tuple[float, ...]:
        """Return the kernel's numbers."""
        return coefficients(self.damper)._replace(**self.extras)

    def with_numbers(self, numbers: Mapping[str, float]) -> HydraulicDamper:
        """Return the damper with other numbers: by path, `extras.name`, or `foaming_1_J`."""
        extras = {k.removeprefix("extras."): v for k, v in numbers.items() if k.startswith("extras.")}
        paths = {k: v for k, v in numbers.items() if k in PATHS}
        foaming = numbers.get("foaming_1_J", self.foaming_1_J)
        return HydraulicDamper(replace_numbers(self.damper, paths), {**self.extras, **extras}, foaming)

    def check_input(self, stroke_m: F, current_A: F) -> None:
        """Raise RigError for unequal lengths, for values that are not finite or a stroke beyond the damper's ends."""
        shapes = f"{stroke_m.shape} strokes and {current_A.shape} currents"
        if stroke_m.ndim != 1 or stroke_m.shape != current_A.shape or len(stroke_m) < 2:
            raise RigError(f"rig: {shapes}; expected equal lengths, at least 2")
        if not (np.isfinite(stroke_m).all() and np.isfinite(current_A).all()):
            raise RigError("rig: a stroke or current is not finite; clean the input first")
        reach = np.abs(stroke_m).max()
        if reach > self.reach_m:
            ends = f"the damper's ends are at ±{self.reach_m:g} m from mid-stroke"
            raise RigError(f"rig: the stroke reaches {reach:.4g} m; {ends}")

    def refresh(self, numbers: F, absorbed_J: float) -> float:
        """Let the air content grow with the absorbed energy (foam; gas coming out of solution)."""
        if self.foaming_1_J == 0.0:
            return np.inf
        numbers[AIR] = min(self.coefficients()[AIR] + self.foaming_1_J * absorbed_J, MAX_AIR_FRACTION)
        return FOAM_EVERY_S
