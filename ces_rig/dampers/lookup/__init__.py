"""The damper known by a table: how dampers vary, and what each effect changes in one."""

from __future__ import annotations

from collections.abc import Mapping

from ces_rig.dampers.lookup import kernel
from ces_rig.dampers.lookup.kernel import Lookup
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
    "compression": 0.15, "rebound": 0.15, "authority": 0.08, "speed_m_s": 0.15, "rise_s": 0.2, "fall_s": 0.2,
    "oil_N_m": 0.2, "gas_Pa": 0.15, "gas_m3": 0.1, "seal_N": 0.2,
}  # fmt: skip
WRONG: Mapping[tuple[str, ...], float] = {
    ("compression",): 0.3, ("rebound",): 0.3, ("authority",): 0.2, ("speed_m_s",): 0.3, ("rise_s",): 0.3,
    ("fall_s",): 0.3, ("oil_N_m",): 0.3, ("gas_Pa",): 0.15, ("gas_m3",): 0.1, ("seal_N",): 0.3, ("mount_N_m",): 0.2,
}  # fmt: skip
SPREADS: Mapping[str, Proportions] = {
    **LUMPED_SPREADS,
    "friction": {
        "seal_N": log_spread(25.0, 60.0), "rise": uniform_spread(0.1, 0.8), "rise_m_s": log_spread(0.01, 0.05),
        "travel_m": log_spread(3e-5, 3e-4),
    },
    "compressibility": {"compliance_m_N": log_spread(1e-7, 4e-7), "air_m": uniform_spread(0.0, 3e-4)},
    "temperature_fade": {"fade_1_K": log_spread(0.005, 0.015), "heat_J_K": log_spread(25.0, 100.0)},
    "blow_off": {"weakness": log_spread(50.0, 110.0), "beyond_Ns_m": log_spread(150.0, 600.0)},
    "valve_lag": {"rise_s": log_spread(5e-3, 2e-2), "fall_s": log_spread(5e-3, 2e-2)},
    "current_hysteresis": {"loop_A": log_spread(0.03, 0.1)},
}  # fmt: skip


def _friction(d: Lookup, s: float, p: Mapping[str, float]) -> dict[str, float]:
    seal = d.seal_N + s * p["seal_N"]
    share = 1.0 - d.seal_N / seal
    return {
        "seal_N": seal,
        "seal_rise": d.seal_rise + share * (p["rise"] - d.seal_rise),
        "seal_m_s": interpolate_log(d.seal_m_s, p["rise_m_s"], share),
        "seal_m": interpolate_log(d.seal_m, p["travel_m"], share),
    }


CHANGES: Mapping[str, Change] = {
    **LUMPED_CHANGES,
    "friction": _friction,
    "compressibility": lambda d, s, p: {
        "oil_N_m": 1.0 / (1.0 / d.oil_N_m + s * p["compliance_m_N"]),
        "air_m": d.air_m + s * p["air_m"],
    },
    "current_hysteresis": add_to(loop_A="loop_A"),
    "temperature_fade": lambda d, s, p: {
        "fade_1_K": d.fade_1_K + s * p["fade_1_K"],
        "heat_J_K": interpolate_log(d.heat_J_K, p["heat_J_K"], s / (0.1 + s)),
    },
    "valve_lag": add_to(rise_s="rise_s", fall_s="fall_s"),
}

KIND = DamperKind(Lookup(), VARIED, WRONG, SPREADS, CHANGES, kernel)
