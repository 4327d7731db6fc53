"""The electro-rheological damper, a plant that calibrates probabilities: how dampers vary, and what effects change."""

from __future__ import annotations

from collections.abc import Mapping

from ces_rig.dampers.effects import Change, Proportions, add_to, interpolate_log, log_spread, uniform_spread
from ces_rig.dampers.model import LUMPED_CHANGES, LUMPED_SPREADS, DamperKind
from ces_rig.dampers.polyviscous import kernel
from ces_rig.dampers.polyviscous.parameters import Polyviscous

VARIED: Mapping[str, float] = {
    "bleed_Ns_m": 0.2, "thinning_N": 0.2, "knee_N": 0.2, "knee_N_A2": 0.15, "knee_rebound": 0.1, "knee_width_N": 0.25,
    "beyond_Ns_m": 0.2, "beyond_rebound": 0.1, "field_s": 0.2, "gas_Pa": 0.15, "gas_m3": 0.1,
}  # fmt: skip
WRONG: Mapping[tuple[str, ...], float] = {
    ("bleed_Ns_m",): 0.3, ("thinning_N",): 0.2, ("knee_N",): 0.25, ("knee_N_A2",): 0.15, ("knee_rebound",): 0.15,
    ("knee_width_N",): 0.3, ("beyond_Ns_m",): 0.2, ("beyond_rebound",): 0.15, ("field_s",): 0.2, ("gas_Pa",): 0.15,
    ("gas_m3",): 0.1, ("gas_s",): 0.3, ("oil_N_m",): 0.2, ("seal_N",): 0.3, ("mount_N_m",): 0.2,
}  # fmt: skip

SPREADS: Mapping[str, Proportions] = {
    **LUMPED_SPREADS,
    "friction": {
        "seal_N": log_spread(25.0, 60.0), "rise": uniform_spread(0.0, 0.8), "rise_m_s": log_spread(0.006, 0.05),
        "travel_m": log_spread(4e-5, 4e-4),
    },
    "compressibility": {"compliance_m_N": log_spread(5e-8, 4e-7), "air_m": log_spread(3e-5, 3e-4)},
    "mount_compliance": {
        "compliance_m_N": log_spread(1.5e-7, 6e-7), "relaxing": uniform_spread(0.1, 1.0),
        "stiffening_1_mm2": uniform_spread(0.0, 3.0),
    },
    "gas_spring": {"pressure": uniform_spread(0.5, 2.0), "volume": log_spread(0.5, 2.0)},
    "cavitation": {"starving": log_spread(15.0, 40.0)},
    "temperature_fade": {"fade_1_K": log_spread(0.004, 0.015), "heat_J_K": log_spread(40.0, 150.0)},
    "leakage": {"bypass_m_sN": log_spread(4e-4, 1.5e-3)},
    "blow_off": {"weakness": log_spread(70.0, 130.0), "beyond_Ns_m": log_spread(150.0, 500.0)},
    "bump_stop": {"stiffness_N_m": log_spread(2e4, 8e4), "hardening_m": log_spread(3e-3, 1e-2)},
    "valve_lag": {"field_s": log_spread(2e-3, 8e-3), "delay_s": uniform_spread(0.0, 6e-3)},
    "current_hysteresis": {"loop_A": log_spread(0.08, 0.25)},
    "sticking_check": {"adhesion_N": log_spread(60.0, 150.0)},
    "late_check": {"closing_s": log_spread(4e-3, 2e-2)},
}  # fmt: skip


def _mount_compliance(d: Polyviscous, s: float, p: Mapping[str, float]) -> dict[str, float]:
    stiffness = 1.0 / (1.0 / d.mount_N_m + s * p["compliance_m_N"])
    share = 1.0 - stiffness / d.mount_N_m
    return {
        "mount_N_m": stiffness,
        "mount_Ns_m": d.mount_Ns_m * stiffness / d.mount_N_m,
        "mount_relaxing": d.mount_relaxing + share * (p["relaxing"] - d.mount_relaxing),
        "mount_stiffening": share * p["stiffening_1_mm2"],
    }


CHANGES: Mapping[str, Change] = {
    **LUMPED_CHANGES,
    "mount_compliance": _mount_compliance,
    "cavitation": lambda d, s, p: {"foot_m_s": d.foot_m_s / (1.0 + s * p["starving"])},
    "temperature_fade": lambda d, s, p: {
        "fade_1_K": d.fade_1_K + s * p["fade_1_K"],
        "heat_J_K": interpolate_log(d.heat_J_K, p["heat_J_K"], s / (0.1 + s)),
    },
    "leakage": add_to(bypass_m_sN="bypass_m_sN"),
    "bump_stop": lambda d, s, p: {
        "stop_clearance_m": d.stop_clearance_m / (1.0 + s), "stop_N_m": p["stiffness_N_m"], "stop_m": p["hardening_m"],
    },
    "valve_lag": add_to(field_s="field_s", delay_s="delay_s"),
}  # fmt: skip

KIND = DamperKind(Polyviscous(), VARIED, WRONG, SPREADS, CHANGES, kernel)
