"""Numerical kernel of the mono-tube damper: linearly implicit Euler, fixed step; slow readable version in the tests.

Pressures are given as forces on the piston's annulus, volumes as its travel. The rod side is stretched by `e`, whose
rate is the piston's speed less the speed `passing_speed(F)` at which oil passes the piston under that force.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import fields
from math import exp, sqrt, tanh
from typing import Any

from numba import njit
from numba.np.unsafe.ndarray import to_fixed_tuple

from ces_data.arrays import F
from ces_rig.dampers.monotube.parameters import Monotube
from ces_rig.drive import kernels as dk

Numbers: Any = namedtuple("Numbers", [f.name for f in fields(Monotube)])  # type: ignore[misc]
SIZE = len(Numbers._fields)

PISTON, SPEED, STRETCH, SPOOL, TEMPERATURE, COIL, FLUX = 0, 1, 2, 3, 4, 5, 6
AIR, TORN, OPENED, SEAL, PILOT, PLAY, PLAYS = 7, 8, 9, 10, 11, 12, 3
STATE_SIZE = 15
STEP_S = 0.1e-3  # halving it changes the force by less than 1 % (test_lumped_kernels)
PLAY_WIDTHS, PLAY_WEIGHTS = (0.4, 1.0, 2.0), (0.5, 0.3, 0.2)  # half widths over the loop's, and their shares
LAMINAR_N = 6.0  # force below which the flow through an orifice is laminar
FULL_M = 0.06
MAX_PACKED = 0.9  # of the length at which the rubber of the stop locks
ATMOSPHERE_PA = 101_325.0


@njit(cache=True)
def gas_pressure(c: Any, x: float) -> float:
    """Return the gas pressure [Pa] behind the floating piston at a piston position [m], polytropic."""
    left = c.gas_m3 - c.rod_m2 * min(x, FULL_M)
    return float(c.gas_Pa * (c.gas_m3 / left) ** c.gas_exponent)


@njit(cache=True)
def gas(c: Any, x: float) -> float:
    """Return the gas force [N] on the rod at a piston position [m]."""
    return float(c.rod_m2 * (gas_pressure(c, x) - ATMOSPHERE_PA))


@njit(cache=True)
def rod_side(c: Any, x: float, e: float, air: float) -> tuple[float, float]:
    """Return the force [N] of the rod side on the annulus when stretched by `e` [m], and minus its slope [N/m].

    Oil and isothermal air: -e = (P - P0) / k + air (1 - P0 / P), which never falls to zero: the air becomes a void.
    """
    full = c.annulus_m2 * c.gas_Pa
    k = c.oil_N_m * c.column_m / (c.column_m + x)
    b = air + e - full / k
    root = sqrt(b * b + 4.0 * air * full / k)
    force = 2.0 * air * full / (b + root) if b > 0.0 else 0.5 * k * (root - b)
    return force, 1.0 / (1.0 / k + air * full / (force * force))


@njit(cache=True)
def orifice(size: float) -> tuple[float, float]:
    """Return the root of a force [N], linear near 0, and its slope."""
    square = size * size + LAMINAR_N * LAMINAR_N
    root = sqrt(sqrt(square))
    return size / root, (square - 0.5 * size * size) / (square * root)


@njit(cache=True)
def round_corner(u: float, width: float) -> tuple[float, float]:
    """Return max(u, 0) with a corner of this width, and its slope."""
    root = sqrt(u * u + width * width)
    return 0.5 * (u + root), 0.5 * (1.0 + u / root)


@njit(cache=True)
def stack(c: Any, s: F, size: float, side: float) -> tuple[float, float]:
    """Return the conductance [m/(s·√N)] of the shim stack under a force [N], in series with its port, and its slope."""
    preload, shim, port = c.compression_N, c.compression_shim, c.compression_port
    if side < 0.0:
        preload, shim, port = c.rebound_N, c.rebound_shim, c.rebound_port
    if s[TORN] * side <= 0.0:
        preload += c.stick_N
    bent, rise = round_corner(size - preload, c.edge_N)
    shut = round_corner(-preload, c.edge_N)[0]
    k = shim * max(bent - shut, 0.0)
    both = sqrt(k * k + port * port)
    return k * port / both, shim * rise * (port / both) ** 3


@njit(cache=True)
def passing_speed(c: Any, s: F, force: float, thin: float) -> tuple[float, float]:
    """Return the speed [m/s] at which oil passes under a force [N], and its slope; `thin` is 1 when cold."""
    size, side = abs(force), 1.0 if force > 0.0 else -1.0
    root, steep = orifice(size)
    k, rise = stack(c, s, size, side)
    over = min(max((size - c.relief_N) / c.relief_band_N, 0.0), 1.0)
    k += c.bleed + c.spool_port * s[SPOOL] + c.relief_port * over
    rise += c.relief_port / c.relief_band_N if 0.0 < over < 1.0 else 0.0
    if s[OPENED] * side < 0.0:  # the other stack has not closed yet
        k += abs(s[OPENED]) * (c.compression_port if side < 0.0 else c.rebound_port)
    past = c.clearance_m_sN * thin
    past += c.groove_m_Ns * exp(-(((s[PISTON] - c.groove_at_m) / c.groove_m) ** 2))
    wide = 1.0 + c.discharge_share * (thin - 1.0)
    return side * (wide * k * root + past * size), wide * (k * steep + rise * root) + past


@njit(cache=True)
def stop(c: Any, x: float) -> tuple[float, float]:
    """Return the force [N] of the stops at a piston position [m], which lock at `stop_m`, and its slope [N/m]."""
    into = abs(x) - c.stop_clearance_m
    if into <= 0.0:
        return 0.0, 0.0
    packed = min(into / c.stop_m, MAX_PACKED)
    slope = c.stop_N_m / (1.0 - packed) ** 2
    force = c.stop_N_m * c.stop_m * packed / (1.0 - packed) + slope * (into - packed * c.stop_m)
    return (force if x > 0.0 else -force), slope


@njit(cache=True)
def slack(c: Any, bend: float) -> tuple[float, float]:
    """Return the bend [m] of the bushing beyond its play, with rounded edges, and the slope."""
    if c.play_m <= 0.0:
        return bend, 1.0
    up, up_slope = round_corner(bend - 0.5 * c.play_m, c.play_edge_m)
    down, down_slope = round_corner(-bend - 0.5 * c.play_m, c.play_edge_m)
    return up - down, up_slope + down_slope


@njit(cache=True)
def field_path(c: Any, s: F, current: float, h: float) -> float:
    """Advance coil, plays, eddy currents and pilot by `h` seconds; return the force [N] that the pilot sets."""
    s[COIL] = dk.first_order_lag(s[COIL], current, c.coil_s, h)
    acting = 0.0
    for k in range(PLAYS):
        half = PLAY_WIDTHS[k] * c.loop_A
        s[PLAY + k] = min(max(s[PLAY + k], s[COIL] - half), s[COIL] + half)
        acting += PLAY_WEIGHTS[k] * s[PLAY + k]
    s[FLUX] = dk.first_order_lag(s[FLUX], acting, c.eddy_s, h)
    pull = max(s[FLUX], 0.0) ** 2 / (1.0 + (s[FLUX] / c.saturation_A) ** 2)
    target = c.pilot_N + c.pilot_N_A2 * pull
    s[PILOT] = dk.first_order_lag(s[PILOT], target, c.pilot_s, h)
    return float(s[PILOT])


@njit(cache=True)
def step(c: Any, s: F, stroke: float, speed: float, setting: float, h: float) -> float:
    """Advance the state by `h` seconds to this stroke [m] and speed [m/s]; return the force [N] in the bushing."""
    x, v, e = s[PISTON], s[SPEED], s[STRETCH]
    warm = s[TEMPERATURE] - c.start_degC
    thin = exp(c.thinning_1_K * warm)
    held_N = c.annulus_m2 * gas_pressure(c, x)
    rod_N, slope = rod_side(c, x, e, s[AIR])
    force = held_N - rod_N
    passed, yielding = passing_speed(c, s, force, thin)
    held = h / (1.0 + h * yielding * slope)
    # seal (Dahl), stop and bushing
    level = c.seal_N * (1.0 + c.seal_rise / (1.0 + (v / c.seal_m_s) ** 2)) + c.side_load_N_m * abs(x - c.side_at_m)
    rub = level / c.seal_m * max(1.0 - (s[SEAL] if v > 0.0 else -s[SEAL]), 0.0)
    f_stop, k_stop = stop(c, x)
    bend, taken_up = slack(c, stroke - x)
    firm = abs(bend) / c.mount_m
    spring = c.mount_N_m * bend * (1.0 + firm)
    k_mount, damping = taken_up * c.mount_N_m * (1.0 + 2.0 * firm), taken_up * c.mount_Ns_m
    drive = spring + damping * speed - gas(c, x) - f_stop - level * s[SEAL] - force + slope * held * passed
    stiff = h * (k_mount + k_stop + rub) + damping + slope * held + c.seal_Ns_m
    new = (c.mass_kg * v + h * drive) / (c.mass_kg + h * stiff)
    s[SPEED], s[PISTON] = new, x + h * new
    s[STRETCH] = e + held * (new - passed)
    end = 1.0 if new > 0.0 else -1.0
    s[SEAL] = end + (s[SEAL] - end) * exp(-abs(h * new) / c.seal_m)
    after = c.annulus_m2 * gas_pressure(c, s[PISTON]) - rod_side(c, s[PISTON], s[STRETCH], s[AIR])[0]
    move_valves(c, s, after, setting, h)
    power = abs(after * (new - (s[STRETCH] - e) / h)) + abs(level * s[SEAL] * new)
    s[TEMPERATURE] += h * (power - c.heat_loss_W_K * warm) / c.heat_J_K
    s[AIR] += h * c.foaming_1_J * power
    return float(spring + damping * speed - (h * k_mount + damping) * new)


@njit(cache=True)
def move_valves(c: Any, s: F, force: float, setting: float, h: float) -> None:
    """Advance spool and shims under a force [N] by `h` seconds."""
    size = abs(force)
    ratio = 1.0 if force < 0.0 else c.pilot_compression
    target = 0.5 * (1.0 + tanh(2.0 * (size - ratio * setting) / c.spool_band_N - 1.0))
    s[SPOOL] = dk.first_order_lag(s[SPOOL], target, c.spool_open_s if target > s[SPOOL] else c.spool_close_s, h)
    preload = c.compression_N if force > 0.0 else c.rebound_N
    if size > preload + c.stick_N:
        s[TORN] = 1.0 if force > 0.0 else -1.0
    elif s[TORN] * force < 0.5 * preload:
        s[TORN] = 0.0
    lifted = max(size - preload, 0.0) / (size + preload)
    s[OPENED] = dk.first_order_lag(s[OPENED], lifted if force > 0.0 else -lifted, c.closing_s, h)


@njit(cache=True)
def settle(c: Any, s: F, stroke: float, speed: float, current: float) -> float:
    """Bring the state to rest at this input and return the force [N]."""
    s[:] = 0.0
    held = gas(c, stroke)
    at = stroke - held / c.mount_N_m - (0.5 * c.play_m if held > 0.0 else -0.5 * c.play_m)
    s[PISTON], s[SPEED], s[TEMPERATURE], s[AIR] = at, speed, c.start_degC, c.air_m
    s[COIL] = s[FLUX] = current
    s[PLAY : PLAY + PLAYS] = current
    field_path(c, s, current, 1e3)
    full, rest = c.annulus_m2 * c.gas_Pa, c.annulus_m2 * gas_pressure(c, at)
    k = c.oil_N_m * c.column_m / (c.column_m + at)
    s[STRETCH] = -(rest - full) / k - c.air_m * (1.0 - full / rest)
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
