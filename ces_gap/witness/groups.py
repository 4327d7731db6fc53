"""The groups of a physical model's parameters that are refitted together, and the effects that would move each."""

from __future__ import annotations

from dataclasses import dataclass

# The valve characteristic ends at the lowest and the highest current recorded; a gain of the current that moves these
# ends moves the curves of the flow map, too.


@dataclass(frozen=True)
class ParameterGroup:
    """A group by the `name` that reports give it: its `parts` in the layout, and the `effects` that would move it."""

    name: str
    parts: tuple[str, ...]
    effects: tuple[str, ...]


GROUPS = (
    ParameterGroup(
        "elasticity",
        ("compliance", "compression", "rebound", "mount"),
        ("mount_compliance", "compressibility", "backlash"),
    ),
    ParameterGroup(
        "friction",
        ("viscous_Ns_m", "stiffness", "yield", "friction", "friction_yield", "growth"),
        ("friction",),
    ),
    ParameterGroup("gas force", ("gas_N",), ("force_offset", "gas_spring", "bump_stop", "force_drift")),
    ParameterGroup("valve lag", ("rise_s", "fall_s", "delay_ticks"), ("valve_lag",)),
    ParameterGroup("magnetic loop", ("hysteresis_A",), ("current_hysteresis",)),
    ParameterGroup("valve characteristic", ("setting",), ("current_scale",)),
    ParameterGroup("lead of the drive", ("lead_s",), ("position_delay",)),
    ParameterGroup("moving mass", ("mass_kg",), ("inertia",)),
    ParameterGroup("refilling", ("check", "refill"), ("cavitation",)),
    ParameterGroup(
        "flow map",
        ("map", "leak", "ratio"),
        ("force_scale", "leakage", "blow_off", "temperature_fade", "calibration", "current_scale"),
    ),
)
