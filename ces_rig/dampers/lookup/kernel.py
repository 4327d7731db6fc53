"""Numerical kernel of the damper known by a table: linearly implicit Euler, fixed step; slow version in the tests.

The series spring is bent by `e`, whose rate is the piston's speed less the speed `passing_speed(F)` at which the table
has its force.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import fields
from math import exp, sqrt
from typing import Any

from numba import njit
from numba.np.unsafe.ndarray import to_fixed_tuple

from ces_data.arrays import F
from ces_rig import drive as dk
from ces_rig.dampers.bouc_wen.kernel import gas, rest_force, slack, stop
from ces_rig.dampers.lookup.parameters import LEVELS, SPEEDS, TABLE, Lookup

NAMES = [f.name for f in fields(Lookup)][:-1]  # those of `LumpedDamper` first, without the table
Scalars: Any = namedtuple("Scalars", NAMES)  # type: ignore[misc]
Numbers: Any = namedtuple("Numbers", NAMES + [f"table_{n}" for n in range(len(TABLE))])  # type: ignore[misc]
SIZE = len(NAMES)

PISTON, SPEED, BEND, SEAL, TEMPERATURE, COIL, HELD, ACTING, AIR = 0, 1, 2, 3, 4, 5, 6, 7, 8
STATE_SIZE = 9
STEP_S = 0.1e-3  # halving it changes the force by less than 1 % (test_lumped_kernels)
COLUMNS = len(SPEEDS)
AIR_N = 80.0  # force that squeezes half of the air
VOID_SHARE = 1e-4  # of the spring's slope left while there is a void


@njit(cache=True)
def spring(c: Any, e: float, air: float) -> tuple[float, float]:
    """Return the force [N] of the spring bent by `e` [m], and its slope: abs(e) = f / k + air f / (f + AIR_N)."""
    b = AIR_N / c.oil_N_m + air - abs(e)
    force = 0.5 * c.oil_N_m * (sqrt(b * b + 4.0 * AIR_N * abs(e) / c.oil_N_m) - b)
    slope = 1.0 / (1.0 / c.oil_N_m + air * AIR_N / (force + AIR_N) ** 2)
    if e > 0.0 and force > c.void_N:
        return c.void_N + VOID_SHARE * (force - c.void_N), VOID_SHARE * slope
    return (force if e > 0.0 else -force), slope


@njit(cache=True)
def passing_speed(c: Any, table: F, acting: float, force: float) -> tuple[float, float]:
    """Return the speed [m/s] at which the table has this force [N] at a current [A], and its slope over the force."""
    at = c.authority * (acting - c.low_A) / (c.high_A - c.low_A) * (LEVELS - 1)
    row = min(max(int(at), 0), LEVELS - 2)
    share = min(max(at - row, 0.0), 1.0)
    wanted = force / (c.compression if force > 0.0 else c.rebound)
    low = share * table[(row + 1) * COLUMNS] + (1.0 - share) * table[row * COLUMNS]
    for k in range(1, COLUMNS):
        high = share * table[(row + 1) * COLUMNS + k] + (1.0 - share) * table[row * COLUMNS + k]
        if wanted < high or k == COLUMNS - 1:
            slope = c.speed_m_s * (SPEEDS[k] - SPEEDS[k - 1]) / (high - low)
            break
        low = high
    return c.speed_m_s * SPEEDS[k - 1] + slope * (wanted - low), slope * wanted / force if force != 0.0 else slope


@njit(cache=True)
def current_path(c: Any, s: F, current: float, h: float) -> None:
    """Advance coil, magnetic loop (a play) and valve by `h` seconds."""
    s[COIL] = dk.first_order_lag(s[COIL], current, c.coil_s, h)
    s[HELD] = min(max(s[HELD], s[COIL] - c.loop_A), s[COIL] + c.loop_A)
    s[ACTING] = dk.first_order_lag(s[ACTING], s[HELD], c.rise_s if s[HELD] > s[ACTING] else c.fall_s, h)


@njit(cache=True)
def step(c: Any, table: F, s: F, stroke: float, speed: float, h: float) -> float:
    """Advance the state by `h` seconds to this stroke [m] and speed [m/s]; return the force [N] in the bushing."""
    x, v, e = s[PISTON], s[SPEED], s[BEND]
    warm = s[TEMPERATURE] - c.start_degC
    kept = exp(-c.fade_1_K * warm)
    force, slope = spring(c, e, s[AIR])
    passed, yielding = passing_speed(c, table, s[ACTING], force / kept)
    over = max(abs(force) - c.relief_N, 0.0)
    slip = c.bypass_m_Ns + c.groove_m_Ns * exp(-(((x - c.groove_at_m) / c.groove_m) ** 2))
    passed += slip * force + (over if force > 0.0 else -over) / c.relief_Ns_m
    yielding = yielding / kept + slip + (1.0 / c.relief_Ns_m if over > 0.0 else 0.0)
    held = h / (1.0 + h * yielding * slope)
    level = c.seal_N * (1.0 + c.seal_rise * exp(-abs(v) / c.seal_m_s)) + c.side_load_N_m * abs(x - c.side_at_m)
    rub = level / c.seal_m if abs(s[SEAL] + h * v) < c.seal_m else 0.0
    f_stop, k_stop = stop(c, x)
    bend, taken_up = slack(c, stroke - x)
    mount, damping = c.mount_N_m * bend, taken_up * c.mount_Ns_m
    drive = mount + damping * speed - gas(c, x) - f_stop - level * s[SEAL] / c.seal_m - force + slope * held * passed
    stiff = h * (taken_up * c.mount_N_m + k_stop + rub) + damping + slope * held
    new = (c.mass_kg * v + h * drive) / (c.mass_kg + h * stiff)
    s[SPEED], s[PISTON], s[BEND] = new, x + h * new, e + held * (new - passed)
    s[SEAL] = min(max(s[SEAL] + h * new, -c.seal_m), c.seal_m)
    power = abs(force * (new - (s[BEND] - e) / h)) + abs(level * new)
    s[TEMPERATURE] += h * (power - c.heat_loss_W_K * warm) / c.heat_J_K
    s[AIR] += h * c.foaming_1_J * power
    return float(mount + damping * speed - (h * taken_up * c.mount_N_m + damping) * new)


@njit(cache=True)
def settle(c: Any, s: F, stroke: float, speed: float, current: float) -> float:
    """Bring the state to rest at this input and return the force [N]."""
    s[:] = 0.0
    held = gas(c, stroke)
    s[PISTON] = stroke - held / c.mount_N_m - (0.5 * c.play_m if held > 0.0 else -0.5 * c.play_m)
    s[SPEED], s[TEMPERATURE], s[AIR] = speed, c.start_degC, c.air_m
    s[COIL] = s[HELD] = s[ACTING] = current
    return float(held)


@njit(cache=True)
def run(
    numbers: F, s: F, mover: int, mover_numbers: F, motion: F, moves: F, interval: float, substeps: int,
    force: F, states: F,
) -> None:  # fmt: skip
    """Step mover and damper through `moves`, as `DamperKind` says."""
    c, table = Scalars(*to_fixed_tuple(numbers[:SIZE], SIZE)), numbers[SIZE:]
    h, zero = interval / substeps, rest_force(c)
    for n in range(1, moves.shape[1]):
        for k in range(1, substeps + 1):
            dk.move(mover, mover_numbers, motion, moves, n, k, interval, substeps)
            current_path(c, s, dk.between(moves[dk.CURRENT], n, k / substeps - 0.5 / substeps), h)
            force[n - 1] = step(c, table, s, motion[dk.STROKE], motion[dk.STROKE_SPEED], h)
            motion[dk.FORCE] = force[n - 1] - zero
        if states.shape[0] > 0:
            states[n - 1] = s
