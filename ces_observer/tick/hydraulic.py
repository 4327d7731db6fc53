"""A damper as a hydraulic network: what of its force is the oil's, and what stands beside it.

    a = (v(k) - v(k-1)) / T, limited,  d = v + lead a
    force(k) = s + gas(x) + viscous d + mass a + (1 + growth max(p_r, 0)) sum_j z_j

with x the stroke, v the speed, T the tick, and d the drive, the speed that moves the oil. The current sets the valve
(`valve`), a setting of which belongs to the step of the `pressures`: it gives the oil's force s = r p_c - p_r and the
friction elements z_j, which the pressure p_r presses. Inputs beyond the reach of the model are clamped to it.
"""

from math import nan

from ces_observer.tick.arrays import Floats, Ints
from ces_observer.tick.curves import find_on_line, is_curve
from ces_observer.tick.edges import EDGES, check_edge
from ces_observer.tick.model import CLAMPED, HELD, STARTED, clamp, hold_force, is_clamped
from ces_observer.tick.mount import FRICTION, check_mount
from ces_observer.tick.pressures import (
    FRICTION_GROWTH, K_PRESSURES_END, N_PRESSURES_END, P_PRESSURES_END, PRESSURE_C, PRESSURE_R, RATIO, S_PRESSURES_END,
    advance_pressures, check_pressures, pressures_reset,
)  # fmt: skip
from ces_observer.tick.valve import check_valve, valve_tick

# p: the widest inputs that are not clamped [m, m/s, A]; drive and side forces [s, m/s^2, 1/s, Ns/m, kg]
(
    WIDE_POSITION_LOW, WIDE_POSITION_HIGH, WIDE_SPEED_LOW, WIDE_SPEED_HIGH, WIDE_CURRENT_LOW, WIDE_CURRENT_HIGH,
    DRIVE_LEAD, MAX_ACCELERATION, DRIVE_RATE, VISCOUS, MASS, P_HYDRAULIC_END,
) = range(P_PRESSURES_END, P_PRESSURES_END + 12)  # fmt: skip

# n: nodes of the gas force, and its tables in p: positions [m] and forces [N]
GAS_NODES, GAS_POSITIONS, GAS_FORCES, N_HYDRAULIC_END = range(N_PRESSURES_END, N_PRESSURES_END + 4)

# s: speed before, drive [m/s], acceleration [m/s^2]
SPEED_BEFORE, DRIVE, ACCELERATION, S_HYDRAULIC_END = range(S_PRESSURES_END, S_PRESSURES_END + 4)

K_HYDRAULIC_END = K_PRESSURES_END


def hydraulic_reset(p: Floats, n: Ints, s: Floats, k: Ints) -> None:
    """Forget the past: chambers at the reservoir's pressure, valves closed, no acceleration."""
    pressures_reset(p, n, s, k)
    k[CLAMPED] = 0
    k[HELD] = 0
    k[STARTED] = 0


def hydraulic_tick(p: Floats, n: Ints, s: Floats, k: Ints, position: float, speed: float, current: float) -> float:
    """Return the force [N] at this tick's inputs [m, m/s, A], held in its range; infinite if it is not finite."""
    k[CLAMPED] = 0
    if is_clamped(p, position, speed, current):
        k[CLAMPED] = 1
        position = clamp(position, p[WIDE_POSITION_LOW], p[WIDE_POSITION_HIGH])
        speed = clamp(speed, p[WIDE_SPEED_LOW], p[WIDE_SPEED_HIGH])
        current = clamp(current, p[WIDE_CURRENT_LOW], p[WIDE_CURRENT_HIGH])
    change = 0.0
    if k[STARTED] != 0:
        limit = p[MAX_ACCELERATION]
        change = clamp((speed - s[SPEED_BEFORE]) * p[DRIVE_RATE], -limit, limit)
    drive = speed + p[DRIVE_LEAD] * change
    s[SPEED_BEFORE] = speed
    s[DRIVE] = drive
    s[ACCELERATION] = change
    gas = find_on_line(p, n[GAS_POSITIONS], n[GAS_FORCES], n[GAS_NODES], position)
    side = gas + p[VISCOUS] * drive + p[MASS] * change
    setting = valve_tick(p, n, s, k, current)
    if not advance_pressures(p, n, s, k, position, drive, setting):
        s[PRESSURE_C] = nan  # no force rather than a wrong one
        s[PRESSURE_R] = nan
    k[STARTED] = 1
    p_r = s[PRESSURE_R]
    growth = p[FRICTION_GROWTH] * p_r if p_r > 0.0 else 0.0
    oil = p[RATIO] * s[PRESSURE_C] - p_r
    return hold_force(p, k, side + (oil + s[FRICTION] * (1.0 + growth)))


def check_hydraulic(p: Floats, n: Ints, numbers: int, counts: int, states: int, flags: int) -> bool:
    """Return whether the tick stays within arrays p, n, s and k of these sizes, and its numbers can be used."""
    if numbers < P_HYDRAULIC_END or counts < N_HYDRAULIC_END or states < S_HYDRAULIC_END or flags < K_HYDRAULIC_END:
        return False
    fits = is_curve(p, n[GAS_POSITIONS], n[GAS_FORCES], n[GAS_NODES], P_HYDRAULIC_END, numbers)
    for edge in range(EDGES):
        fits = fits and check_edge(p, n, numbers, P_HYDRAULIC_END, edge)
    return (
        fits
        and check_valve(p, n, numbers, states, P_HYDRAULIC_END, S_HYDRAULIC_END)
        and check_mount(p, n, numbers, states, flags, P_HYDRAULIC_END, S_HYDRAULIC_END, K_HYDRAULIC_END)
        and check_pressures(p, n, numbers, P_HYDRAULIC_END)
        and p[MAX_ACCELERATION] >= 0.0
    )
