"""The mono-tube damper with a piloted spool, for sealed tests only: how dampers vary, and what effects change."""

from __future__ import annotations

from collections.abc import Mapping

from ces_rig.dampers.effects import Change, Proportions, add_to, interpolate_log, log_spread, uniform_spread
from ces_rig.dampers.model import LUMPED_CHANGES, LUMPED_SPREADS, DamperKind
from ces_rig.dampers.monotube import kernel
from ces_rig.dampers.monotube.parameters import Monotube

VARIED: Mapping[str, float] = {
    "bleed": 0.2, "compression_N": 0.2, "compression_shim": 0.2, "rebound_N": 0.2, "rebound_shim": 0.2, "edge_N": 0.2,
    "pilot_N": 0.2, "pilot_N_A2": 0.15, "pilot_compression": 0.1, "saturation_A": 0.1, "spool_port": 0.2,
    "spool_band_N": 0.2, "spool_open_s": 0.2, "spool_close_s": 0.2, "pilot_s": 0.2, "gas_Pa": 0.12, "gas_m3": 0.1,
    "seal_Ns_m": 0.3,
}  # fmt: skip
WRONG: Mapping[tuple[str, ...], float] = {
    ("bleed",): 0.25, ("compression_N",): 0.3, ("compression_shim",): 0.25, ("rebound_N",): 0.3,
    ("rebound_shim",): 0.25, ("pilot_N",): 0.3, ("pilot_N_A2",): 0.2, ("pilot_compression",): 0.15,
    ("saturation_A",): 0.2, ("spool_port",): 0.25, ("spool_band_N",): 0.25,
    ("spool_open_s", "spool_close_s"): 0.2, ("gas_Pa",): 0.1, ("gas_m3",): 0.1,
    ("oil_N_m",): 0.2, ("seal_N",): 0.3, ("seal_Ns_m",): 0.4, ("mount_N_m",): 0.2,
}  # fmt: skip

SPREADS: Mapping[str, Proportions] = {
    **LUMPED_SPREADS,
    "friction": {
        "seal_N": log_spread(25.0, 60.0), "rise": uniform_spread(0.0, 0.8), "rise_m_s": log_spread(0.006, 0.05),
        "travel_m": log_spread(2e-5, 3e-4),
    },
    "compressibility": {"compliance_m_N": log_spread(1e-7, 5e-7), "air_m": log_spread(2e-5, 3e-4)},
    "mount_compliance": {
        "compliance_m_N": log_spread(1.5e-7, 6e-7), "relaxation_s": log_spread(1e-4, 8e-4),
        "stiffening_m": log_spread(5e-4, 5e-3),
    },
    "backlash": {"play_m": log_spread(2e-4, 6e-4), "edge_m": log_spread(3e-6, 3e-5)},
    "cavitation": {"gas_loss": log_spread(0.5, 1.5), "air": log_spread(0.2, 2.0)},
    "temperature_fade": {
        "thinning_1_K": log_spread(0.006, 0.02), "discharge": uniform_spread(0.6, 1.4),
        "heat_J_K": log_spread(40.0, 150.0),
    },
    "leakage": {"clearance_m_sN": log_spread(2e-5, 8e-5), "bleed": uniform_spread(0.0, 8e-4)},
    "blow_off": {"weakness": log_spread(70.0, 130.0), "port": log_spread(0.02, 0.08),
                 "band_N": log_spread(60.0, 300.0)},
    "bump_stop": {"stiffness_N_m": log_spread(3e4, 2e5), "lock_m": log_spread(0.015, 0.05)},
    "valve_lag": {"pilot_s": log_spread(4e-3, 2e-2), "eddy_s": uniform_spread(0.0, 6e-3)},
    "current_hysteresis": {"loop_A": log_spread(0.03, 0.1)},
    "sticking_check": {"adhesion_N": log_spread(60.0, 150.0)},
    "late_check": {"closing_s": log_spread(4e-3, 2e-2)},
}  # fmt: skip


def _temperature_fade(d: Monotube, s: float, p: Mapping[str, float]) -> dict[str, float]:
    share = s / (0.1 + s)
    return {
        "thinning_1_K": d.thinning_1_K + s * p["thinning_1_K"],
        "discharge_share": d.discharge_share + share * (p["discharge"] - d.discharge_share),
        "heat_J_K": interpolate_log(d.heat_J_K, p["heat_J_K"], share),
    }


CHANGES: Mapping[str, Change] = {
    **LUMPED_CHANGES,
    "backlash": lambda d, s, p: {"play_m": d.play_m + s * p["play_m"], "play_edge_m": p["edge_m"]},
    "cavitation": lambda d, s, p: {  # gas is lost; some of it is then in the oil
        "gas_Pa": d.gas_Pa / (1.0 + s * p["gas_loss"]), "air_m": d.air_m * (1.0 + s * p["air"]),
    },
    "temperature_fade": _temperature_fade,
    "leakage": add_to(clearance_m_sN="clearance_m_sN", bleed="bleed"),
    "blow_off": lambda d, s, p: {
        "relief_N": d.relief_N / (1.0 + s * p["weakness"]), "relief_port": p["port"], "relief_band_N": p["band_N"],
    },
    "bump_stop": lambda d, s, p: {
        "stop_clearance_m": d.stop_clearance_m / (1.0 + s), "stop_N_m": p["stiffness_N_m"], "stop_m": p["lock_m"],
    },
    "valve_lag": add_to(pilot_s="pilot_s", eddy_s="eddy_s"),
}  # fmt: skip

KIND = DamperKind(Monotube(), VARIED, WRONG, SPREADS, CHANGES, kernel)
