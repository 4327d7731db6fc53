"""Numerical kernel of the ER damper: linearly implicit Euler with a fixed step; slow readable version in the tests.

Forces are positive in compression. The oil's spring is bent by `e`, whose rate is the piston's speed less the speed
`passing_speed(F)` at which oil passes the piston under that force.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import fields
from math import exp, sinh, sqrt, tanh
from typing import Any

from numba import njit
from numba.np.unsafe.ndarray import to_fixed_tuple

from ces_data.arrays import F
from ces_rig.dampers.polyviscous.parameters import Polyviscous
from ces_rig.drive import kernels as dk

Numbers: Any = namedtuple("Numbers", [f.name for f in fields(Polyviscous)])  # type: ignore[misc]
SIZE = len(Numbers._fields)

PISTON, SPEED, BEND, LIFT, TEMPERATURE, COIL, FIELD_1, FIELD_2 = 0, 1, 2, 3, 4, 5, 6, 7
POLAR, RELAXED, GAS_HEAT, AIR, TORN, LATE, VOID, JENKINS, ELEMENTS = 8, 9, 10, 11, 12, 13, 14, 15, 4
OPENED = 19
STATE_SIZE = 20
STEP_S = 0.1e-3  # halving it changes the force by less than 1 % (test_lumped_kernels)
ADIABATIC = 1.4
MIN_FORCE_N = 5.0  # [N] below which leakage is laminar
FULL_M = 0.06
ATMOSPHERE_PA = 101_325.0


@njit(cache=True)
def oil_spring(c: Any, e: float, air: float) -> tuple[float, float]:
    """Return the force [N] of the oil bent by `e` [m], and its slope: e = F/k + air·F/(|F| + air_N)."""
    bend, k = abs(e), c.oil_N_m
    half = 0.5 * (k * (bend - air) - c.air_N)
    force = half + sqrt(half * half + k * bend * c.air_N)
    slope = 1.0 / (1.0 / k + air * c.air_N / (force + c.air_N) ** 2)
    return (force if e > 0.0 else -force), slope


@njit(cache=True)
def passing_speed(c: Any, s: F, force: float, thin: float) -> tuple[float, float]:
    """Return the speed [m/s] at which oil passes under a force [N], and its slope; `thin` is 1 when cold."""
    size, side = abs(force), 1.0 if force > 0.0 else -1.0
    knee = (c.knee_N + c.knee_N_A2 * s[FIELD_2] ** 2) / thin
    beyond = c.beyond_Ns_m / thin
    if side < 0.0:
        knee *= c.knee_rebound
        beyond *= c.beyond_rebound
    if s[TORN] * side <= 0.0:
        knee += c.stick_N
    reduced = min(size / c.thinning_N, 6.0)
    bleed = thin / c.bleed_Ns_m
    u = (size - knee) / c.knee_width_N
    rest = c.knee_width_N * dk.softplus(-knee / c.knee_width_N)
    passed = bleed * c.thinning_N * sinh(reduced) + (c.knee_width_N * dk.softplus(u) - rest) / beyond
    slope = bleed * sqrt(1.0 + sinh(reduced) ** 2) + 1.0 / (1.0 + exp(-min(max(u, -50.0), 50.0))) / beyond
    square = size * size + MIN_FORCE_N * MIN_FORCE_N
    root = sqrt(sqrt(square))
    passed += c.bypass_m_sN * size / root
    slope += c.bypass_m_sN * (square - 0.5 * size * size) / (square * root)
    groove = c.groove_m_Ns * exp(-(((s[PISTON] - c.groove_at_m) / c.groove_m) ** 2))
    open_now = s[LIFT] / c.relief_Ns_m + groove
    if s[OPENED] * side < 0.0:  # the valve of the other direction has not closed yet
        open_now += abs(s[OPENED]) / beyond
    return side * (passed + open_now * size), slope + open_now


@njit(cache=True)
def gas(c: Any, x: float) -> float:
    """Return the isothermal gas force [N] on the rod at a piston position [m]."""
    left = c.gas_m3 - c.rod_m2 * min(x, FULL_M)
    return float(c.rod_m2 * (c.gas_Pa * c.gas_m3 / left - ATMOSPHERE_PA))


@njit(cache=True)
def rubber(c: Any, x: float) -> tuple[float, float]:
    """Return the force [N] of the stops at a piston position [m], exponential, and its slope [N/m]."""
    into = abs(x) - c.stop_clearance_m
    if into <= 0.0:
        return 0.0, 0.0
    grown = exp(min(into / c.stop_m, 8.0))
    force = c.stop_N_m * c.stop_m * (grown - 1.0)
    return (force if x > 0.0 else -force), c.stop_N_m * grown


@njit(cache=True)
def slack(c: Any, bend: float) -> tuple[float, float]:
    """Return the bend [m] of the bushing beyond its play, with soft edges, and the slope."""
    if c.play_m <= 0.0:
        return bend, 1.0
    half, w = 0.5 * c.play_m, c.play_edge_m
    up, down = (bend - half) / w, (-bend - half) / w
    rise = 1.0 / (1.0 + exp(-min(max(up, -50.0), 50.0))) + 1.0 / (1.0 + exp(-min(max(down, -50.0), 50.0)))
    return w * (dk.softplus(up) - dk.softplus(down)), rise


@njit(cache=True)
def field_path(c: Any, s: F, current: float, late: float, h: float) -> None:
    """Advance amplifier, dead time, polarisation (one play operator) and the fluid's two equal lags by `h` seconds."""
    s[COIL] = dk.first_order_lag(s[COIL], current, c.coil_s, h)
    s[LATE] = dk.first_order_lag(s[LATE], late, c.coil_s, h)
    s[POLAR] = min(max(s[POLAR], s[LATE] - c.loop_A), s[LATE] + c.loop_A)
    s[FIELD_1] = dk.first_order_lag(s[FIELD_1], s[POLAR], c.field_s, h)
    s[FIELD_2] = dk.first_order_lag(s[FIELD_2], s[FIELD_1], c.field_s, h)


@njit(cache=True)
def seal(c: Any, s: F, h: float) -> tuple[float, float]:
    """Return the present force [N] of the Jenkins elements, and their slope over the next step [N/m]."""
    level = c.seal_N * (1.0 + c.seal_rise * exp(-abs(s[SPEED]) / c.seal_m_s))
    level += c.side_load_N_m * abs(s[PISTON] - c.side_at_m)
    force, slope = 0.0, 0.0
    for k in range(ELEMENTS):
        travel = c.seal_m * 2.0 * (k + 0.5) / ELEMENTS
        stiffness = level / ELEMENTS / travel
        force += stiffness * s[JENKINS + k]
        if abs(s[JENKINS + k] + h * s[SPEED]) < travel:
            slope += stiffness
    return force, slope


@njit(cache=True)
def slide(c: Any, s: F, move: float) -> None:
    """Move the Jenkins elements by `move` metres; each slips at its own travel."""
    for k in range(ELEMENTS):
        travel = c.seal_m * 2.0 * (k + 0.5) / ELEMENTS
        s[JENKINS + k] = min(max(s[JENKINS + k] + move, -travel), travel)


@njit(cache=True)
def step(c: Any, s: F, stroke: float, speed: float, h: float) -> float:
    """Advance the state by `h` seconds to this stroke [m] and speed [m/s]; return the force [N] in the bushing."""
    x, v = s[PISTON], s[SPEED]
    warm = s[TEMPERATURE] - c.start_degC
    thin = 1.0 + c.fade_1_K * warm
    force, slope = oil_spring(c, s[BEND], s[AIR])
    passed, yielding = passing_speed(c, s, force, thin)
    held = h / (1.0 + h * yielding * slope)
    if s[VOID] > 0.0 and s[BEND] >= 0.0:  # compression finds no oil yet
        held = passed = 0.0
    f_seal, k_seal = seal(c, s, h)
    f_stop, k_stop = rubber(c, x)
    bend, rise = slack(c, stroke - x)
    bend_mm = 1e3 * bend
    k_stay = c.mount_N_m * (1.0 + 3.0 * c.mount_stiffening * bend_mm * bend_mm)
    k_relax = c.mount_N_m * c.mount_relaxing
    spring = c.mount_N_m * bend * (1.0 + c.mount_stiffening * bend_mm * bend_mm) + k_relax * (bend - s[RELAXED])
    k_mount, c_mount = rise * (k_stay + k_relax), rise * c.mount_Ns_m
    drive = spring + c_mount * speed - gas(c, x) - s[GAS_HEAT] - f_stop - f_seal - force + slope * held * passed
    stiff = h * (k_mount + k_stop + k_seal) + c_mount + slope * held
    new = (c.mass_kg * v + h * drive) / (c.mass_kg + h * stiff)
    s[SPEED], s[PISTON] = new, x + h * new
    before = s[BEND]
    s[BEND] += held * (new - passed)
    s[VOID] = max(s[VOID] - h * (new + c.foot_m_s), 0.0)
    if s[VOID] > 0.0:
        s[BEND] = min(s[BEND], 0.0)
    s[RELAXED] += (1.0 - exp(-h / c.mount_s)) * (bend - s[RELAXED])
    s[GAS_HEAT] = (s[GAS_HEAT] + (ADIABATIC - 1.0) * (gas(c, s[PISTON]) - gas(c, x))) * exp(-h / c.gas_s)
    slide(c, s, h * new)
    after = oil_spring(c, s[BEND], s[AIR])[0]
    s[LIFT] = dk.first_order_lag(s[LIFT], tanh(max(abs(after) - c.relief_N, 0.0) / (0.2 * c.relief_N)), c.relief_s, h)
    knee = (c.knee_N + c.knee_N_A2 * s[FIELD_2] ** 2) * (1.0 if after > 0.0 else c.knee_rebound)
    if abs(after) > knee + c.stick_N:
        s[TORN] = 1.0 if after > 0.0 else -1.0
    elif s[TORN] * after < 0.5 * knee:
        s[TORN] = 0.0
    lifted = max(abs(after) - knee, 0.0) / (abs(after) + c.knee_width_N)
    s[OPENED] = dk.first_order_lag(s[OPENED], lifted if after > 0.0 else -lifted, c.closing_s, h)
    power = abs(after * (new - (s[BEND] - before) / h)) + abs(f_seal * new)
    s[TEMPERATURE] += h * (power - c.heat_loss_W_K * warm) / c.heat_J_K
    s[AIR] += h * c.foaming_1_J * power
    return float(spring + c_mount * speed - (h * k_mount + c_mount) * new)


@njit(cache=True)
def settle(c: Any, s: F, stroke: float, speed: float, current: float) -> float:
    """Bring the state to rest at this input and return the force [N]."""
    s[:] = 0.0
    held = gas(c, stroke)
    s[PISTON] = stroke - held / c.mount_N_m - (0.5 * c.play_m if held > 0.0 else -0.5 * c.play_m)
    s[SPEED], s[TEMPERATURE], s[AIR] = speed, c.start_degC, c.air_m
    s[COIL] = s[LATE] = s[POLAR] = s[FIELD_1] = s[FIELD_2] = current
    s[RELAXED] = slack(c, stroke - s[PISTON])[0]
    return float(held)


@njit(cache=True)
def rest_force(c: Any) -> float:
    """Return the gas force [N] at mid-stroke."""
    return float(gas(c, 0.0))


@njit(cache=True)
def run(
    numbers: F, s: F, mover: int, mover_numbers: F, motion: F, moves: F, interval: float, substeps: int,
    force: F, states: F,
) -> None:  # fmt: skip
    """Step mover and damper through `moves`, as `DamperKind` says."""
    c = Numbers(*to_fixed_tuple(numbers, SIZE))
    h, zero = interval / substeps, rest_force(c)
    for n in range(1, moves.shape[1]):
        for k in range(1, substeps + 1):
            dk.move(mover, mover_numbers, motion, moves, n, k, interval, substeps)
            r = (k - 0.5) / substeps
            field_path(c, s, dk.between(moves[dk.CURRENT], n, r), dk.between(moves[dk.LATE], n, r), h)
            force[n - 1] = step(c, s, motion[dk.STROKE], motion[dk.STROKE_SPEED], h)
            motion[dk.FORCE] = force[n - 1] - zero
        if states.shape[0] > 0:
            states[n - 1] = s
