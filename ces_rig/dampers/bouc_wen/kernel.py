"""Numerical kernel of the MR damper: linearly implicit Euler with a fixed step; slow readable version in the tests.

Forces are positive in compression. The numbers are those of `LumpedDamper`, then those of `BoucWen`. The fluid's
spring is bent by `e`; across it the modified Bouc–Wen element moves at `v_in`, with F = c1·dy/dt and
F = f_y·z + c0·(v_in − dy/dt) + k0·(x_in − y).
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import fields
from math import exp, log1p, sqrt, tanh
from typing import Any

from numba import njit
from numba.np.unsafe.ndarray import to_fixed_tuple

from ces_data.arrays import F
from ces_rig import drive as dk
from ces_rig.dampers.bouc_wen.parameters import BoucWen

Numbers: Any = namedtuple("Numbers", [f.name for f in fields(BoucWen)])  # type: ignore[misc]
SIZE = len(Numbers._fields)

PISTON, SPEED, BEND, DASHPOT, YIELDED, BRISTLE, TEMPERATURE, COIL = 0, 1, 2, 3, 4, 5, 6, 7
FIELD, EDDY, REMANENT, BUBBLES = 8, 9, 10, 11
STATE_SIZE = 12
STEP_S = 0.1e-3  # halving it changes the force by less than 1 % (test_lumped_kernels)
BUBBLE_SHARE = 0.92  # of the fluid's stiffness lost while bubbles are squeezed
VOID_SHARE = 1e-4  # of it left while there is a void
STANDSTILL_M_S = 1e-6
ATMOSPHERE_PA = 101_325.0
EDGE_M = 4e-6  # [m] softness of the edges of the play
FULL_M = 0.06  # [m] stroke for which the gas volume is designed


@njit(cache=True)
def fluid_spring(c: Any, e: float, bubbles: float) -> tuple[float, float]:
    """Return the force [N] of the fluid bent by `e` [m], and its slope [N/m]: bubbles soften it, a void cuts it off."""
    stiffness = c.fluid_N_m if e > 0.0 else c.fluid_N_m * c.fluid_rebound
    bend = abs(e)
    force, slope = stiffness * bend, stiffness
    if bubbles > 0.0:
        left = exp(-bend / bubbles)
        force -= BUBBLE_SHARE * stiffness * bubbles * (1.0 - left)
        slope -= BUBBLE_SHARE * stiffness * left
    if e > 0.0 and force > c.void_N:
        force = c.void_N + VOID_SHARE * (force - c.void_N)
        slope *= VOID_SHARE
    return (force if e > 0.0 else -force), slope


@njit(cache=True)
def gas(c: Any, x: float) -> float:
    """Return the gas force [N] on the rod at a piston position [m]."""
    left = c.gas_m3 - c.rod_m2 * min(x, FULL_M)
    return float(c.rod_m2 * (c.gas_Pa * (c.gas_m3 / left) ** c.gas_exponent - ATMOSPHERE_PA))


@njit(cache=True)
def stop(c: Any, x: float) -> tuple[float, float]:
    """Return the force [N] of the stops at a piston position [m], and its slope [N/m]."""
    into = abs(x) - c.stop_clearance_m
    if into <= 0.0:
        return 0.0, 0.0
    grown = c.stop_progression_1_m * into
    force = c.stop_N_m * into * (1.0 + grown)
    return (force if x > 0.0 else -force), c.stop_N_m * (1.0 + 2.0 * grown)


@njit(cache=True)
def slack(c: Any, bend: float) -> tuple[float, float]:
    """Return the bend [m] of the bushing beyond its play, and the slope: 1 outside, 0 inside."""
    if c.play_m <= 0.0:
        return bend, 1.0
    up, down = (bend - 0.5 * c.play_m) / EDGE_M, (-bend - 0.5 * c.play_m) / EDGE_M
    beyond = max(up, 0.0) + log1p(exp(-abs(up))) - max(down, 0.0) - log1p(exp(-abs(down)))
    return EDGE_M * beyond, 1.0 / (1.0 + exp(-max(up, -50.0))) + 1.0 / (1.0 + exp(-max(down, -50.0)))


@njit(cache=True)
def field_path(c: Any, s: F, current: float, h: float) -> float:
    """Advance coil, remanence (Duhem), fluid response and eddy currents by `h` seconds; return the field [A]."""
    before = s[COIL]
    s[COIL] = dk.first_order_lag(before, current, c.coil_s, h)
    change = s[COIL] - before
    side = c.remanence_A if change > 0.0 else -c.remanence_A
    s[REMANENT] = side + (s[REMANENT] - side) * exp(-abs(change) / c.remanence_bend_A)
    s[FIELD] = dk.first_order_lag(s[FIELD], s[COIL] - s[REMANENT], c.field_s, h)
    s[EDDY] = dk.first_order_lag(s[EDDY], s[FIELD], c.eddy_s, h)
    return float(max(s[EDDY], 0.0))


@njit(cache=True)
def step(c: Any, s: F, stroke: float, speed: float, field: float, h: float) -> float:
    """Advance the state by `h` seconds to this stroke [m] and speed [m/s]; return the force [N] in the bushing."""
    x, v, e, z = s[PISTON], s[SPEED], s[BEND], s[YIELDED]
    warm = s[TEMPERATURE] - c.start_degC
    f_y = (c.yield_N + c.yield_N_A * c.saturation_A * tanh(field / c.saturation_A)) * exp(-c.fade_yield_1_K * warm)
    c_0 = (c.viscous_Ns_m + c.viscous_Ns_mA * field) * exp(-c.fade_viscous_1_K * warm)
    # fluid: bend and yield, linear in the new speed
    force, slope = fluid_spring(c, e, s[BUBBLES])
    across = c.inner_N_m * (x - e - s[DASHPOT])
    pull = force - f_y * z - across
    give = 1.0 + abs(z) ** c.sharpness * (-1.0 if pull * z > 0.0 else 2.0 * c.unloading - 1.0)
    resist = c_0 + h * f_y * give / c.yield_m
    over = max(abs(force) - c.relief_N, 0.0)
    slip = c.bypass_m_Ns + c.groove_m_Ns * exp(-(((x - c.groove_at_m) / c.groove_m) ** 2))
    past = force * slip + (over if force > 0.0 else -over) / c.relief_Ns_m
    yielding = slip + (1.0 / c.relief_Ns_m if over > 0.0 else 0.0) + 1.0 / c.series_Ns_m + 1.0 / resist
    held = h / (1.0 + h * yielding * slope)
    passed = pull / resist + force / c.series_Ns_m + past
    # seal
    level = c.seal_N * (1.0 + (c.seal_static - 1.0) * exp(-((v / c.stribeck_m_s) ** 2)))
    level += c.side_load_N_m * abs(x - c.side_at_m) + 1e-9
    relax = c.bristle_N_m * sqrt(v * v + STANDSTILL_M_S * STANDSTILL_M_S) / level
    kept = 1.0 / (1.0 + h * relax)
    rub = (c.bristle_N_m - c.bristle_Ns_m * relax) * kept
    # bushing
    bend, taken_up = slack(c, stroke - x)
    spring, damping = c.mount_N_m * bend, taken_up * c.mount_Ns_m
    f_stop, k_stop = stop(c, x)
    drive = spring + damping * speed - gas(c, x) - f_stop - force + slope * held * passed - rub * s[BRISTLE]
    stiff = h * (taken_up * c.mount_N_m + k_stop + rub) + damping + slope * held + c.bristle_Ns_m
    new = (c.mass_kg * v + h * drive) / (c.mass_kg + h * stiff)
    # take the step
    s[SPEED] = new
    s[PISTON] = x + h * new
    s[BEND] = e + held * (new - passed)
    after = fluid_spring(c, s[BEND], s[BUBBLES])[0]
    inside = (after - f_y * z - across) / resist
    s[DASHPOT] += h * after / c.series_Ns_m
    s[YIELDED] = min(max(z + h * give * inside / c.yield_m, -1.0), 1.0)
    s[BRISTLE] = (s[BRISTLE] + h * new) * kept
    rubbed = c.bristle_N_m * s[BRISTLE]
    power = abs(after * (new - (s[BEND] - e) / h)) + abs(rubbed * new)
    s[TEMPERATURE] += h * (power - c.heat_loss_W_K * warm) / c.heat_J_K
    s[BUBBLES] += h * c.foaming_1_J * power
    return float(spring + damping * speed - (h * taken_up * c.mount_N_m + damping) * new)


@njit(cache=True)
def settle(c: Any, s: F, stroke: float, speed: float, current: float) -> float:
    """Bring the state to rest at this input and return the force [N]."""
    s[:] = 0.0
    held = gas(c, stroke)
    s[PISTON] = s[DASHPOT] = stroke - held / c.mount_N_m - (0.5 * c.play_m if held > 0.0 else -0.5 * c.play_m)
    s[SPEED], s[TEMPERATURE], s[BUBBLES] = speed, c.start_degC, c.bubbles_m
    s[COIL] = s[FIELD] = s[EDDY] = current
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
            field = field_path(c, s, dk.between(moves[dk.CURRENT], n, k / substeps - 0.5 / substeps), h)
            force[n - 1] = step(c, s, motion[dk.STROKE], motion[dk.STROKE_SPEED], field, h)
            motion[dk.FORCE] = force[n - 1] - zero
        if states.shape[0] > 0:
            states[n - 1] = s
