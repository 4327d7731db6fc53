"""A magneto-rheological (MR) damper: parameters of Spencer's modified Bouc–Wen model, and its numerical kernel.

The model is that of B. F. Spencer et al., J. Eng. Mech. 123 (1997), with normalised hysteresis (|z| <= 1), surrounded
by the spring of the fluid, gas, seals, stops, a mass and a bushing. The kernel is a linearly implicit Euler with a
fixed step. Forces are positive in compression. The fluid's spring is bent by
`e`; across it the modified Bouc–Wen element moves at `v_in`, with F = c1·dy/dt and
F = f_y·z + c0·(v_in − dy/dt) + k0·(x_in − y).
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass, fields
from math import exp, log1p, sqrt, tanh
from typing import Any, ClassVar

from numba import njit
from numba.np.unsafe.ndarray import to_fixed_tuple

from ces_data.arrays import F
from ces_observer.records import quantity
from ces_rig import drive as dk
from ces_rig.dampers.model import LumpedDamper


@dataclass(frozen=True)
class BoucWen(LumpedDamper):
    """An MR damper; raises RigError if a number is out of range."""

    kind: ClassVar[str] = "bouc_wen"
    current_A: ClassVar[tuple[float, float]] = (0.1, 1.6)

    yield_N: float = quantity(70.0, "N", "yield force of the fluid without field", 0.0, 1e5)
    yield_N_A: float = quantity(650.0, "N/A", "growth of the yield force with the field", 0.0, 1e5)
    saturation_A: float = quantity(1.6, "A", "field at which that growth saturates (tanh)", 0.01, 100.0)
    yield_m: float = quantity(5e-4, "m", "displacement over which the fluid yields", 1e-5, 0.1)
    sharpness: float = quantity(2.0, "1", "exponent n of the Bouc–Wen law", 1.0, 10.0)
    unloading: float = quantity(0.6, "1", "share gamma of the Bouc–Wen law", 0.5, 1.0)
    viscous_Ns_m: float = quantity(600.0, "N·s/m", "viscous damping c0 without field", 1.0, 1e6)
    viscous_Ns_mA: float = quantity(350.0, "N·s/(m·A)", "growth of the viscous damping with the field", 0.0, 1e6)
    series_Ns_m: float = quantity(2.5e4, "N·s/m", "dashpot c1 in series", 100.0, 1e8)
    inner_N_m: float = quantity(900.0, "N/m", "spring k0 across the fluid", 0.0, 1e7)
    fluid_N_m: float = quantity(1.2e7, "N/m", "stiffness of the fluid and its chambers", 1e4, 1e10)
    fluid_rebound: float = quantity(1.0, "1", "ratio of that stiffness in rebound to compression", 0.1, 10.0)
    bubbles_m: float = quantity(0.0, "m", "travel in which bubbles are squeezed out", 0.0, 0.02)
    field_s: float = quantity(4e-3, "s", "time constant of the fluid's response to the field", 0.0, 0.5)
    eddy_s: float = quantity(0.0, "s", "further time constant, of eddy currents", 0.0, 0.5)
    remanence_A: float = quantity(0.0, "A", "half width of the magnetic loop", 0.0, 2.0)
    remanence_bend_A: float = quantity(0.15, "A", "change of current that crosses 63 % of the loop", 1e-3, 10.0)
    gas_Pa: float = quantity(1.5e6, "Pa", "accumulator pressure at mid-stroke", 1e4, 1e7)
    gas_m3: float = quantity(6e-5, "m³", "accumulator gas volume at mid-stroke", 1e-6, 1e-2)
    gas_exponent: float = quantity(1.3, "1", "polytropic exponent", 1.0, 1.67)
    rod_m2: float = quantity(1.2e-4, "m²", "rod area", 1e-6, 1e-2)
    seal_N: float = quantity(4.0, "N", "sliding friction of the seals", 0.0, 5e3)
    seal_static: float = quantity(1.2, "1", "ratio of breakaway to sliding friction", 1.0, 5.0)
    stribeck_m_s: float = quantity(0.015, "m/s", "Stribeck speed", 1e-4, 1.0)
    bristle_N_m: float = quantity(2e5, "N/m", "presliding stiffness", 1e2, 1e8)
    bristle_Ns_m: float = quantity(80.0, "N·s/m", "presliding damping", 0.0, 1e5)
    mass_kg: float = quantity(0.35, "kg", "rod and piston, beyond the bushing", 0.05, 20.0)
    stop_N_m: float = quantity(2e5, "N/m", "stiffness of the stop", 0.0, 1e8)
    fade_yield_1_K: float = quantity(0.0, "1/K", "relative fall of the yield force with temperature", 0.0, 0.1)
    fade_viscous_1_K: float = quantity(0.0, "1/K", "relative fall of the viscous damping", 0.0, 0.1)


Numbers: Any = namedtuple("Numbers", [f.name for f in fields(BoucWen)])  # type: ignore[misc]
SIZE = len(Numbers._fields)

PISTON, SPEED, BEND, DASHPOT, YIELDED, BRISTLE, TEMPERATURE, COIL = 0, 1, 2, 3, 4, 5, 6, 7
FIELD, EDDY, REMANENT, BUBBLES = 8, 9, 10, 11
STATE_SIZE = 12
STEP_S = 0.1e-3  # halving it changes the force by less than 1 % (test_lumped)
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
