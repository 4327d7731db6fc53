"""The parameters that all physical models share, valve path and side forces, with starts read off the data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ces_identify.numerics.arrays import F
from ces_identify.physical.layout import Group, group, rises_to_nodes
from ces_identify.trained.training import Training
from ces_observer.structures.increasing_curves import IncreasingCurve
from ces_observer.structures.side_forces import FrictionElement, SideForces
from ces_observer.structures.valve_path import ValvePath

CURRENTS = 6  # nodes of the valve's characteristic
POSITIONS = 5  # nodes of the gas force
LAG_S, MAX_LAG_S = 6e-3, 0.2
DELAY_S, MAX_DELAY_S = 5e-4, 0.02
LOOP, MAX_LOOP = 0.01, 0.2  # half width of the magnetic loop, relative to the range of currents
MAX_LEAD_S = 3e-3
MASS_KG, MAX_MASS_KG = 0.5, 20.0
ACCELERATION_MARGIN = 1.2
MIN_RISE = 1e-3  # of a curve between nodes, relative to that of a straight line from end to end
FORCE_PERCENTILE, SPEED_PERCENTILE = 99.5, 99.9


@dataclass(frozen=True)
class DataScales:
    """What is read off the data: scales of force [N] and speed [m/s], ranges of current and position, acceleration."""

    force_N: float
    speed_m_s: float
    currents_A: F
    positions_m: F
    max_acceleration_m_s2: float
    interval_s: float


def read_scales(data: Training, rate_Hz: float) -> DataScales:
    """Return the scales of the training data, and nodes spread over the currents and positions."""
    position, speed, current = data.inputs
    scored = (data.estimation > 0.0) | (data.selection > 0.0)
    low, high = float(current.min()), float(current.max())
    if high - low < 1e-6 * max(1.0, abs(high)):
        low, high = low - 0.5, high + 0.5
    ends = np.percentile(position, [0.1, 99.9])
    if ends[1] - ends[0] < 1e-9:
        ends = ends + np.array([-1e-3, 1e-3])
    jumps = np.concatenate([np.abs(np.diff(speed[a:b])) for a, b in data.segments])
    return DataScales(
        float(np.percentile(np.abs(data.measured[scored]), FORCE_PERCENTILE)),
        float(np.percentile(np.abs(speed), SPEED_PERCENTILE)),
        np.linspace(low, high, CURRENTS),
        np.linspace(float(ends[0]), float(ends[1]), POSITIONS),
        ACCELERATION_MARGIN * rate_Hz * float(np.percentile(jumps, SPEED_PERCENTILE)),
        1.0 / rate_Hz,
    )


def valve_groups(scales: DataScales) -> list[Group]:
    """Return lags, loop, delay [ticks] and characteristic, in the order that the kernels expect."""
    span = float(np.ptp(scales.currents_A))
    nodes = len(scales.currents_A)
    rises = np.vstack([rises_to_nodes(nodes - 1, 0), np.zeros((1, nodes - 2))])
    even = np.full(nodes - 2, 1.0 / (nodes - 1))
    return [
        group("rise_s", LAG_S, 0.0, MAX_LAG_S),
        group("fall_s", LAG_S, 0.0, MAX_LAG_S),
        group("hysteresis_A", LOOP * span, 0.0, MAX_LOOP * span),
        group("delay_ticks", DELAY_S / scales.interval_s, 0.0, MAX_DELAY_S / scales.interval_s),
        group("setting", even, MIN_RISE, 1.0, rises, np.append(np.zeros(nodes - 1), 1.0),
              max_sum=1.0 - MIN_RISE),
    ]  # fmt: skip


def side_groups(scales: DataScales) -> list[Group]:
    """Return lead, viscous and inertia forces, and the gas force over the stroke."""
    size = scales.force_N
    viscous = 0.01 * size / scales.speed_m_s
    return [
        group("lead_s", 0.0, -MAX_LEAD_S, MAX_LEAD_S, scale=5e-4),
        group("viscous_Ns_m", viscous, 0.0, 100.0 * viscous),
        group("mass_kg", MASS_KG, 0.0, MAX_MASS_KG),
        group("gas_N", np.zeros(POSITIONS), -5.0 * size, 5.0 * size, scale=0.05 * size),
    ]


def build_valve(scales: DataScales, values: dict[str, F]) -> ValvePath:
    """Return the valve path."""
    return ValvePath(
        IncreasingCurve(as_floats(scales.currents_A), as_floats(values["setting"])),
        float(values["delay_ticks"][0]),
        float(values["hysteresis_A"][0]),
        float(values["rise_s"][0]),
        float(values["fall_s"][0]),
    )


def build_side(scales: DataScales, values: dict[str, F], friction: tuple[FrictionElement, ...] = ()) -> SideForces:
    """Return the side forces."""
    return SideForces(
        float(values["lead_s"][0]),
        scales.max_acceleration_m_s2,
        float(values["viscous_Ns_m"][0]),
        float(values["mass_kg"][0]),
        as_floats(scales.positions_m),
        as_floats(values["gas_N"]),
        friction,
    )


def shared_parameters(valve: ValvePath, side: SideForces) -> F:
    """Return the kernels' first parameters: those of `valve_groups` and `side_groups`, in this order."""
    path = [valve.rise_s, valve.fall_s, valve.hysteresis_A, valve.delay_ticks, *valve.characteristic.values]
    return np.array([*path, side.lead_s, side.viscous_Ns_m, side.mass_kg, *side.gas_N])


def as_floats(values: F) -> tuple[float, ...]:
    """Return an array as plain floats."""
    return tuple(map(float, values))
