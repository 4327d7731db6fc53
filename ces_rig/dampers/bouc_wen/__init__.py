"""The magneto-rheological damper, a modified Bouc-Wen model: how dampers vary, and what each effect changes in one."""

from __future__ import annotations

from collections.abc import Mapping

from ces_rig.dampers.bouc_wen import kernel
from ces_rig.dampers.bouc_wen.kernel import BoucWen
from ces_rig.dampers.model import (
    LUMPED_CHANGES,
    LUMPED_SPREADS,
    Change,
    DamperKind,
    Proportions,
    add_to,
    interpolate_log,
    log_spread,
    uniform_spread,
)

VARIED: Mapping[str, float] = {
    "yield_N": 0.2, "yield_N_A": 0.15, "saturation_A": 0.15, "yield_m": 0.25, "viscous_Ns_m": 0.2,
    "viscous_Ns_mA": 0.2, "series_Ns_m": 0.2, "inner_N_m": 0.2, "field_s": 0.2, "gas_Pa": 0.15, "gas_m3": 0.1,
}  # fmt: skip
WRONG: Mapping[tuple[str, ...], float] = {
    ("yield_N",): 0.4, ("yield_N_A",): 0.25, ("saturation_A",): 0.3, ("yield_m",): 0.4, ("sharpness",): 0.15,
    ("viscous_Ns_m",): 0.3, ("viscous_Ns_mA",): 0.4, ("series_Ns_m",): 0.2, ("inner_N_m",): 0.4, ("field_s",): 0.2,
    ("gas_Pa",): 0.15, ("gas_m3",): 0.1, ("fluid_N_m",): 0.2, ("seal_N",): 0.3, ("mount_N_m",): 0.2,
}  # fmt: skip

SPREADS: Mapping[str, Proportions] = {
    **LUMPED_SPREADS,
    "friction": {
        "seal_N": log_spread(25.0, 60.0), "static": uniform_spread(1.1, 1.9), "stribeck_m_s": log_spread(0.006, 0.04),
        "bristle_N_m": log_spread(1e5, 1e6),
    },
    "compressibility": {
        "compliance_m_N": log_spread(1.5e-7, 5e-7), "bubbles_m": uniform_spread(0.0, 3e-4),
        "rebound": log_spread(0.6, 1.6),
    },
    "temperature_fade": {
        "yield_1_K": log_spread(0.004, 0.012), "viscous_1_K": log_spread(0.004, 0.015),
        "heat_J_K": log_spread(40.0, 150.0),
    },
    "blow_off": {"weakness": log_spread(70.0, 130.0), "beyond_Ns_m": log_spread(150.0, 600.0)},
    "valve_lag": {"field_s": log_spread(5e-3, 2e-2), "eddy_s": uniform_spread(0.0, 6e-3)},
    "current_hysteresis": {"loop_A": log_spread(0.04, 0.12), "bend_A": log_spread(0.06, 0.3)},
    "foaming": {"growth_m_J": log_spread(2e-7, 1e-6)},
}  # fmt: skip


def _friction(d: BoucWen, s: float, p: Mapping[str, float]) -> dict[str, float]:
    seal = d.seal_N + s * p["seal_N"]
    share = 1.0 - d.seal_N / seal
    return {
        "seal_N": seal,
        "seal_static": interpolate_log(d.seal_static, p["static"], share),
        "stribeck_m_s": interpolate_log(d.stribeck_m_s, p["stribeck_m_s"], share),
        "bristle_N_m": interpolate_log(d.bristle_N_m, p["bristle_N_m"], share),
    }


def _compressibility(d: BoucWen, s: float, p: Mapping[str, float]) -> dict[str, float]:
    stiffness = 1.0 / (1.0 / d.fluid_N_m + s * p["compliance_m_N"])
    return {
        "fluid_N_m": stiffness,
        "fluid_rebound": interpolate_log(d.fluid_rebound, p["rebound"], 1.0 - stiffness / d.fluid_N_m),
        "bubbles_m": d.bubbles_m + s * p["bubbles_m"],
    }


def _temperature_fade(d: BoucWen, s: float, p: Mapping[str, float]) -> dict[str, float]:
    return {
        "fade_yield_1_K": d.fade_yield_1_K + s * p["yield_1_K"],
        "fade_viscous_1_K": d.fade_viscous_1_K + s * p["viscous_1_K"],
        "heat_J_K": interpolate_log(d.heat_J_K, p["heat_J_K"], s / (0.1 + s)),
    }


CHANGES: Mapping[str, Change] = {
    **LUMPED_CHANGES,
    "friction": _friction,
    "compressibility": _compressibility,
    "temperature_fade": _temperature_fade,
    "valve_lag": add_to(field_s="field_s", eddy_s="eddy_s"),
    "current_hysteresis": lambda d, s, p: {
        "remanence_A": d.remanence_A + s * p["loop_A"], "remanence_bend_A": p["bend_A"],
    },
}  # fmt: skip

KIND = DamperKind(BoucWen(), VARIED, WRONG, SPREADS, CHANGES, kernel)
