"""Converts a damper's parameters to the flat numbers of the kernel: diameters to areas, lengths to volumes."""

from __future__ import annotations

from ces_rig.dampers.hydraulic.kernel import Coefficients
from ces_rig.dampers.hydraulic.parameters import CheckValve, Damper


def coefficients(damper: Damper) -> Coefficients:
    """Return the kernel's coefficients of `damper`."""
    b, oil, piston, ces, gas = damper.body, damper.oil, damper.piston, damper.ces_valve, damper.reservoir
    seal, mount, heat = damper.seal, damper.mount, damper.heat
    return Coefficients(
        damper.piston_area_m2, damper.annulus_area_m2, damper.rod_area_m2,
        damper.piston_area_m2 * b.half_stroke_m + b.compression_dead_m3,
        damper.annulus_area_m2 * b.half_stroke_m + b.rebound_dead_m3,
        b.moving_mass_kg, b.bump_clearance_m, b.bump_stiffness_N_m,
        b.bump_progression_1_m,
        oil.density_kg_m3, oil.bulk_modulus_Pa, oil.air_fraction, 1.0 / oil.air_exponent, oil.vapour_pressure_Pa,
        oil.viscosity_fall_1_K, oil.discharge_rise_1_K,
        *_check(piston.compression), piston.bleed_area_m2, piston.leakage_m3_sPa,
        piston.blow_off_Pa, piston.blow_off_area_m2, piston.blow_off_band_Pa,
        *_check(damper.top_checks.compression), *_check(damper.top_checks.rebound),
        ces.area_m2, ces.band_Pa, ces.poppet_s, ces.pilot_area_m2, ces.cracking_low_Pa, ces.cracking_high_Pa,
        ces.current_low_A, ces.current_high_A, ces.saturation_A, ces.allowed_low_A, ces.allowed_high_A,
        ces.solenoid_s, ces.pilot_rise_s, ces.pilot_fall_s, ces.hysteresis_A,
        gas.pressure_Pa, gas.gas_m3, gas.gas_m3 + gas.oil_m3, 1.0 / gas.exponent,
        seal.coulomb_N, seal.static_N, seal.pressure_1_Pa, seal.stribeck_m_s, seal.bristle_N_m, seal.bristle_Ns_m,
        seal.viscous_Ns_m, mount.stiffness_N_m, mount.damping_Ns_m, mount.play_m,
        heat.ambient_degC, heat.capacity_J_K, heat.loss_W_K,
    )  # fmt: skip


def _check(valve: CheckValve) -> tuple[float, float, float, float, float]:
    return valve.area_m2, valve.cracking_Pa, valve.full_open_Pa, valve.opening_s, valve.closing_s
