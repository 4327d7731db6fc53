"""The hydraulic CES damper as a plant: its effect-free design, how dampers vary, and what each effect changes in one.

Every effect changes parameters of the differential equations in `ces_rig.dampers.hydraulic.kernel`; none adds a force
from outside.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import exp

from ces_rig.dampers.hydraulic import kernel
from ces_rig.dampers.hydraulic.parameters import Damper, HydraulicDamper
from ces_rig.dampers.model import (
    Change,
    DamperKind,
    Proportions,
    add_to,
    interpolate_log,
    log_spread,
    replace_numbers,
    uniform_spread,
)

RELEASE_PA = 8.5e4  # [Pa] at which oil saturated with gas releases it
DESIGN: Mapping[str, float] = {
    "body.moving_mass_kg": 0.35, "body.bump_clearance_m": 0.055, "body.bump_stiffness_N_m": 2e5,
    "oil.air_fraction": 0.0006, "oil.bulk_modulus_Pa": 1.6e9, "piston.blow_off_Pa": 3e7, "piston.leakage_m3_sPa": 8e-13,
    "ces_valve.hysteresis_A": 0.001, "ces_valve.pilot_rise_s": 6e-3, "ces_valve.pilot_fall_s": 4.5e-3,
    "reservoir.pressure_Pa": 1.6e5, "reservoir.gas_m3": 8e-5, "seal.coulomb_N": 4.0, "seal.static_N": 5.0,
    "seal.pressure_1_Pa": 5e-8, "seal.viscous_Ns_m": 20.0, "mount.stiffness_N_m": 2e7, "mount.damping_Ns_m": 3e3,
    "heat.capacity_J_K": 4000.0, "top_checks.compression.area_m2": 9e-5, "top_checks.compression.cracking_Pa": 4e3,
    "top_checks.compression.full_open_Pa": 2.5e4,
}  # fmt: skip
VARIED: Mapping[str, float] = {
    "piston.compression.area_m2": 0.2, "piston.compression.full_open_Pa": 0.2, "piston.bleed_area_m2": 0.2,
    "ces_valve.area_m2": 0.2, "ces_valve.band_Pa": 0.2, "ces_valve.pilot_area_m2": 0.2,
    "ces_valve.cracking_low_Pa": 0.15, "ces_valve.cracking_high_Pa": 0.15, "ces_valve.pilot_rise_s": 0.2,
    "ces_valve.pilot_fall_s": 0.2, "reservoir.pressure_Pa": 0.15, "reservoir.gas_m3": 0.15, "oil.air_fraction": 0.2,
    "seal.viscous_Ns_m": 0.3, "body.rebound_dead_m3": 0.2, "body.compression_dead_m3": 0.2,
}  # fmt: skip
"""Parameters that vary from damper to damper, with the standard deviations of their logarithms."""
WRONG: Mapping[tuple[str, ...], float] = {
    ("piston.compression.area_m2",): 0.2, ("piston.compression.cracking_Pa",): 0.3,
    ("piston.compression.full_open_Pa",): 0.2, ("piston.bleed_area_m2",): 0.2, ("ces_valve.area_m2",): 0.2,
    ("ces_valve.band_Pa",): 0.2, ("ces_valve.pilot_area_m2",): 0.2, ("ces_valve.cracking_low_Pa",): 0.2,
    ("ces_valve.cracking_high_Pa",): 0.1, ("ces_valve.saturation_A",): 0.3, ("ces_valve.pilot_rise_s",): 0.15,
    ("ces_valve.pilot_fall_s",): 0.15, ("reservoir.pressure_Pa",): 0.1, ("reservoir.gas_m3",): 0.1,
    ("oil.air_fraction",): 0.1, ("seal.viscous_Ns_m",): 0.4, ("seal.coulomb_N", "seal.static_N"): 0.3,
    ("mount.stiffness_N_m",): 0.2,
}  # fmt: skip
"""Parameters that are wrong in a simulation (those of one key by the same factor), with the standard deviation of the
factor's logarithm at size 1."""

SPREADS: Mapping[str, Proportions] = {
    "friction": {
        "coulomb_N": log_spread(25.0, 60.0), "static": uniform_spread(1.05, 1.8),
        "stribeck_m_s": log_spread(0.006, 0.04), "bristle_N_m": log_spread(1.5e5, 1.5e6),
        "pressure_1_Pa": uniform_spread(0.0, 1.5e-7),
    },
    "compressibility": {"compliance_1_Pa": log_spread(2e-10, 1e-9), "air": log_spread(5e-4, 5e-3)},
    "mount_compliance": {"compliance_m_N": log_spread(1.5e-7, 6e-7), "relaxation_s": log_spread(1e-4, 8e-4)},
    "backlash": {"play_m": log_spread(2e-4, 6e-4)},
    "inertia": {"mass_kg": log_spread(1.5, 4.0)},
    "gas_spring": {"pressure": uniform_spread(1.0, 4.0), "volume": log_spread(0.5, 2.0),
                   "exponent": uniform_spread(1.05, 1.4)},
    "cavitation": {
        "choke": log_spread(0.04, 0.25), "gas_loss": log_spread(0.05, 0.25), "release": log_spread(0.5, 2.0),
    },
    "temperature_fade": {
        "discharge_1_K": log_spread(0.003, 0.008), "viscosity_1_K": uniform_spread(0.0, 0.01),
        "capacity_J_K": log_spread(40.0, 150.0), "warm_K": uniform_spread(0.0, 6.0),
    },
    "leakage": {
        "ring_m3_sPa": log_spread(2e-12, 8e-12), "bleed_m2": uniform_spread(0.0, 2e-7),
        "seat_m2": uniform_spread(0.0, 6e-8),
    },
    "blow_off": {
        "weakness": log_spread(5.0, 9.0), "area_m2": log_spread(8e-6, 2.5e-5), "band_Pa": log_spread(6e5, 3e6),
    },
    "bump_stop": {"stiffness_N_m": log_spread(3e4, 2e5), "progression_1_m": uniform_spread(0.0, 120.0)},
    "valve_lag": {"rise_s": log_spread(5e-3, 2e-2), "fall_s": log_spread(4e-3, 1.5e-2)},
    "current_hysteresis": {"width_A": log_spread(0.012, 0.04)},
    "groove": {"area_m2": log_spread(2e-7, 6e-7), "at_m": uniform_spread(-0.012, 0.012),
               "width_m": log_spread(0.004, 0.01)},
    "foaming": {"growth_1_J": log_spread(1e-6, 5e-6)},
    "side_load": {"slope_N_m": log_spread(2e3, 5e3), "at_m": uniform_spread(-0.01, 0.01)},
    "sticking_check": {"adhesion_Pa": log_spread(1.5e5, 4e5)},
    "late_check": {"piston_s": log_spread(4e-3, 2e-2), "intake_s": log_spread(4e-3, 2e-2)},
}  # fmt: skip


def _friction(d: Damper, s: float, p: Mapping[str, float]) -> dict[str, float]:
    seal, extra = d.seal, s * p["coulomb_N"]
    share = extra / (extra + seal.coulomb_N)
    return {
        "seal.coulomb_N": seal.coulomb_N + extra,
        "seal.static_N": seal.static_N + extra * p["static"],
        "seal.stribeck_m_s": interpolate_log(seal.stribeck_m_s, p["stribeck_m_s"], share),
        "seal.bristle_N_m": interpolate_log(seal.bristle_N_m, p["bristle_N_m"], share),
        "seal.pressure_1_Pa": seal.pressure_1_Pa + share * p["pressure_1_Pa"],
    }


def _mount_compliance(d: Damper, s: float, p: Mapping[str, float]) -> dict[str, float]:
    stiffness = 1.0 / (1.0 / d.mount.stiffness_N_m + s * p["compliance_m_N"])
    share = 1.0 - stiffness / d.mount.stiffness_N_m
    relaxation = interpolate_log(d.mount.damping_Ns_m / d.mount.stiffness_N_m, p["relaxation_s"], share)
    return {"mount.stiffness_N_m": stiffness, "mount.damping_Ns_m": relaxation * stiffness}


def _gas_spring(d: Damper, s: float, p: Mapping[str, float]) -> dict[str, float]:
    gas, smallest = d.reservoir, 1.1 * d.rod_area_m2 * d.body.half_stroke_m
    return {
        "reservoir.pressure_Pa": gas.pressure_Pa * (1.0 + s * p["pressure"]),
        "reservoir.gas_m3": smallest + (gas.gas_m3 - smallest) / (1.0 + s * p["volume"]),
        "reservoir.exponent": interpolate_log(gas.exponent, p["exponent"], s / (1.0 + s)),
    }


def _temperature_fade(d: Damper, s: float, p: Mapping[str, float]) -> dict[str, float]:
    share = s / (0.1 + s)
    return {
        "oil.discharge_rise_1_K": d.oil.discharge_rise_1_K + s * p["discharge_1_K"],
        "oil.viscosity_fall_1_K": d.oil.viscosity_fall_1_K + share * p["viscosity_1_K"],
        "heat.capacity_J_K": interpolate_log(d.heat.capacity_J_K, p["capacity_J_K"], share),
        "heat.start_degC": d.heat.start_degC + share * p["warm_K"],
    }


CHANGES: Mapping[str, Change] = {
    "friction": _friction,
    "compressibility": lambda d, s, p: {
        "oil.bulk_modulus_Pa": 1.0 / (1.0 / d.oil.bulk_modulus_Pa + s * p["compliance_1_Pa"]),
        "oil.air_fraction": d.oil.air_fraction + s * p["air"],
    },
    "mount_compliance": _mount_compliance,
    "backlash": add_to(play_m="mount.play_m"),
    "inertia": add_to(mass_kg="body.moving_mass_kg"),
    "gas_spring": _gas_spring,
    "cavitation": lambda d, s, p: {
        "top_checks.compression.area_m2": d.top_checks.compression.area_m2 / (1.0 + s * p["choke"]),
        "reservoir.pressure_Pa": d.reservoir.pressure_Pa / (1.0 + s * p["gas_loss"]),
        "oil.vapour_pressure_Pa": RELEASE_PA + (d.oil.vapour_pressure_Pa - RELEASE_PA) * exp(-s * p["release"]),
    },
    "temperature_fade": _temperature_fade,
    "leakage": add_to(
        ring_m3_sPa="piston.leakage_m3_sPa", bleed_m2="piston.bleed_area_m2", seat_m2="ces_valve.pilot_area_m2"
    ),
    "blow_off": lambda d, s, p: {
        "piston.blow_off_Pa": d.piston.blow_off_Pa / (1.0 + s * p["weakness"]),
        "piston.blow_off_area_m2": p["area_m2"], "piston.blow_off_band_Pa": p["band_Pa"],
    },
    "bump_stop": lambda d, s, p: {
        "body.bump_clearance_m": d.body.bump_clearance_m / (1.0 + s), "body.bump_stiffness_N_m": p["stiffness_N_m"],
        "body.bump_progression_1_m": p["progression_1_m"],
    },
    "valve_lag": add_to(rise_s="ces_valve.pilot_rise_s", fall_s="ces_valve.pilot_fall_s"),
    "current_hysteresis": add_to(width_A="ces_valve.hysteresis_A"),
    "groove": lambda _d, s, p: {
        "extras.groove_area": s * p["area_m2"], "extras.groove_at": p["at_m"], "extras.groove_width": p["width_m"],
    },
    "foaming": lambda _d, s, p: {"foaming_1_J": s * p["growth_1_J"]},
    "side_load": lambda _d, s, p: {"extras.side_load": s * p["slope_N_m"], "extras.side_at": p["at_m"]},
    "late_check": add_to(piston_s="piston.compression.closing_s", intake_s="top_checks.compression.closing_s"),
    "sticking_check": lambda _d, s, p: {"extras.check_stick": s * p["adhesion_Pa"]},
}  # fmt: skip

KIND = DamperKind(HydraulicDamper(replace_numbers(Damper(), DESIGN)), VARIED, WRONG, SPREADS, CHANGES, kernel)
