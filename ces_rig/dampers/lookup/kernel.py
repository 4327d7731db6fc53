"""A damper known by a table: its force over speed and current, in series with a spring, and the parts around it.

The table is a dyno's result: the packaged one is made up, `learn_lookup` makes one of a recording. The kernel is a
linearly implicit Euler with a fixed step. The series spring is bent by `e`, whose rate
is the piston's speed less the speed `passing_speed(F)` at which the table has its force.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import astuple, dataclass, fields, replace
from itertools import product
from math import exp, sqrt
from typing import Any, ClassVar

import numpy as np
from numba import njit
from numba.np.unsafe.ndarray import to_fixed_tuple
from scipy.signal import butter, lfilter, sosfiltfilt

from ces_data.arrays import F
from ces_data.recording import Recording
from ces_observer.records import quantity
from ces_rig import drive as dk
from ces_rig.dampers.bouc_wen.kernel import gas, rest_force, slack, stop
from ces_rig.dampers.model import LumpedDamper
from ces_rig.errors import RigError
from ces_rig.limits import MapLimits

SPEEDS = (-1.0, -0.5, -0.2, -0.06, 0.0, 0.06, 0.2, 0.5, 1.0)  # columns of the table, over `speed_m_s`
LEVELS = 4  # rows: currents from `low_A` to `high_A` at equal distances
TABLE = (
    -950.0, -560.0, -300.0, -120.0, 0.0, 60.0, 150.0, 330.0, 620.0,
    -1350.0, -930.0, -600.0, -290.0, 0.0, 140.0, 290.0, 480.0, 790.0,
    -2050.0, -1520.0, -1120.0, -580.0, 0.0, 270.0, 510.0, 710.0, 1050.0,
    -2900.0, -2200.0, -1700.0, -900.0, 0.0, 420.0, 760.0, 980.0, 1350.0,
)  # fmt: skip
MIN_SLOPE = 5.0  # [N·s/m] of the force over speed


@dataclass(frozen=True)
class Lookup(LumpedDamper):
    """A damper known by a table; raises RigError if a number is out of range or the force falls with speed."""

    kind: ClassVar[str] = "lookup"

    low_A: float = quantity(0.2, "A", "current of the table's first row", 0.0, 100.0)
    high_A: float = quantity(1.6, "A", "current of its last row", 0.01, 100.0)
    speed_m_s: float = quantity(1.5, "m/s", "speed of its last column", 0.01, 100.0)
    compression: float = quantity(1.0, "1", "factor of the forces in compression", 0.05, 20.0)
    rebound: float = quantity(1.0, "1", "factor of the forces in rebound", 0.05, 20.0)
    authority: float = quantity(1.0, "1", "factor of the current's distance from the first row", 0.05, 20.0)
    rise_s: float = quantity(6e-3, "s", "time constant of the valve towards more force", 0.0, 0.5)
    fall_s: float = quantity(4e-3, "s", "time constant towards less", 0.0, 0.5)
    loop_A: float = quantity(0.0, "A", "half width of the magnetic loop", 0.0, 2.0)
    oil_N_m: float = quantity(4e6, "N/m", "stiffness in series with the table", 1e4, 1e10)
    air_m: float = quantity(0.0, "m", "travel in which air in it is squeezed out", 0.0, 0.02)
    gas_Pa: float = quantity(1.2e6, "Pa", "gas pressure at mid-stroke", 1e4, 1e7)
    gas_m3: float = quantity(5e-5, "m³", "gas volume at mid-stroke", 1e-6, 1e-2)
    gas_exponent: float = quantity(1.25, "1", "polytropic exponent", 1.0, 1.67)
    rod_m2: float = quantity(1.3e-4, "m²", "rod area", 1e-6, 1e-2)
    seal_N: float = quantity(6.0, "N", "sliding friction of the seals", 0.0, 5e3)
    seal_rise: float = quantity(0.1, "1", "relative rise of friction at standstill", 0.0, 5.0)
    seal_m_s: float = quantity(0.02, "m/s", "speed at which 63 % of that rise has gone", 1e-4, 1.0)
    seal_m: float = quantity(8e-5, "m", "presliding travel", 1e-6, 0.1)
    mass_kg: float = quantity(0.3, "kg", "rod and piston, beyond the bushing", 0.05, 20.0)
    stop_N_m: float = quantity(1e5, "N/m", "stiffness of the stop", 0.0, 1e8)
    fade_1_K: float = quantity(0.0, "1/K", "relative fall of the table's force with temperature", 0.0, 0.1)
    table: tuple[float, ...] = quantity(TABLE, "N", "forces, row after row: a row for each current", -1e6, 1e6)

    def __post_init__(self) -> None:
        super().__post_init__()
        rows = [self.table[n : n + len(SPEEDS)] for n in range(0, len(self.table), len(SPEEDS))]
        steps = [
            (b - a) / (v - u) for row in rows for a, b, u, v in zip(row, row[1:], SPEEDS, SPEEDS[1:], strict=False)
        ]
        if len(self.table) != LEVELS * len(SPEEDS) or min(steps) < 0.99 * MIN_SLOPE * self.speed_m_s:
            raise RigError(f"lookup: table: expected {LEVELS} rows of {len(SPEEDS)} forces that rise with the speed")
        if self.high_A <= self.low_A:
            raise RigError(f"lookup: high_A is {self.high_A:g}; expected more than low_A, {self.low_A:g}")

    @property
    def current_A(self) -> tuple[float, float]:
        """The currents of the table [A]."""
        return self.low_A, self.high_A

    def coefficients(self) -> tuple[float, ...]:
        """Return the kernel's numbers: all fields, the table last."""
        *numbers, table = astuple(self)
        return (*numbers, *table)


GRID_S = 1e-3  # [s] of a recording that a table is learned from
SMOOTHING_HZ = 40.0
LAGS_S = (1e-3, 2e-3, 4e-3, 7e-3, 12e-3, 20e-3)
STIFFNESSES_N_m = (5e5, 1e6, 2e6, 4e6, 8e6, 2e7)
SMOOTHNESS = 0.02  # weight of the differences between neighbours in the table
ZERO = SPEEDS.index(0.0)


def learn_lookup(recording: Recording) -> Lookup:
    """Return the damper; raises RigError if the force of the recording does not follow its speed and current."""
    speed, force, current = _read_signals(recording)
    low, high = (float(value) for value in np.percentile(current, [1.0, 99.0]))
    if high - low < MapLimits.MIN_CURRENTS_A:
        raise RigError(f"{recording.name}: currents from {low:.3g} to {high:.3g} A; expected several, to learn a map")
    largest = float(np.percentile(np.abs(speed), 99.5))
    rate, best = np.gradient(force, GRID_S), (np.inf, 0.0, 0.0, np.zeros(0))
    for lag, stiffness in product(LAGS_S, STIFFNESSES_N_m):
        kept = float(np.exp(-GRID_S / lag))
        acting = lfilter([1.0 - kept], [1.0, -kept], current, zi=[kept * current[0]])[0]
        share = (acting - low) / (high - low) * (LEVELS - 1)
        table, left = _fit_table((speed - rate / stiffness) / largest, share, force)
        best = min(best, (left, lag, stiffness, table), key=lambda one: one[0])
    left, lag, stiffness, table = best
    if left > 1.0 - MapLimits.MIN_EXPLAINED:
        raise RigError(
            f"{recording.name}: speed and current explain {max(1.0 - left, 0.0):.0%} of its force; expected at least "
            f"{MapLimits.MIN_EXPLAINED:.0%}; check signs and delays"
        )
    rising = _rise(table, largest)
    return replace(
        Lookup(), low_A=max(low, 0.0), high_A=high, speed_m_s=largest, rise_s=lag, fall_s=lag, oil_N_m=stiffness,
        table=tuple(rising.ravel().tolist()),
    )  # fmt: skip


def _read_signals(recording: Recording) -> tuple[F, F, F]:
    """Return speed [m/s], force [N] and current [A] (n,) on a uniform grid, the first two without fast parts."""
    channels = [recording.channel(name) for name in ("position", "force", "current")]
    start, end = (int(f(c.stamps_ns[i] for c in channels)) for f, i in ((max, 0), (min, -1)))
    grid = np.arange(start, end, round(1e9 * GRID_S))
    position, force, current = (np.interp(grid, c.stamps_ns, c.values) for c in channels)
    sos = butter(2, SMOOTHING_HZ, fs=1.0 / GRID_S, output="sos")
    return np.gradient(sosfiltfilt(sos, position), GRID_S), sosfiltfilt(sos, force), current


def _fit_table(speed: F, level: F, force: F) -> tuple[F, float]:
    """Return the table [N] (LEVELS, speeds) without a constant force, and the share of the variance that it leaves."""
    hats = [_hats(speed, np.array(SPEEDS)), _hats(level, np.arange(LEVELS, dtype=np.float64))]
    design = np.einsum("nl,ns->nls", hats[1], np.delete(hats[0], ZERO, axis=1)).reshape(len(force), -1)
    design = np.column_stack([design, np.ones(len(force))])
    steps = np.eye(LEVELS * (len(SPEEDS) - 1), design.shape[1])
    rough = SMOOTHNESS * np.sqrt(len(force)) * (steps[len(SPEEDS) - 1 :] - steps[: 1 - len(SPEEDS)])
    normal = design.T @ design + rough.T @ rough + 1e-9 * len(force) * np.eye(design.shape[1])
    values = np.linalg.solve(normal, design.T @ force)
    left = float(np.var(force - design @ values) / np.var(force))
    return np.insert(values[:-1].reshape(LEVELS, -1), ZERO, 0.0, axis=1), left


def _hats(values: F, knots: F) -> F:
    """Return the hat functions (n, knots) of values, which are clipped at the ends."""
    inside = np.clip(values, knots[0], knots[-1])
    return np.stack([np.interp(inside, knots, one) for one in np.eye(len(knots))], axis=1)


def _rise(table: F, largest: float) -> F:
    """Return the table with forces that rise with speed on both sides of zero."""
    least = MIN_SLOPE * largest * np.array(SPEEDS)
    right = np.maximum.accumulate(np.maximum(table - least, 0.0)[:, ZERO:], axis=1)
    left = np.minimum.accumulate(np.minimum(table - least, 0.0)[:, ZERO::-1], axis=1)[:, ::-1]
    return np.concatenate([left[:, :-1], right], axis=1) + least


NAMES = [f.name for f in fields(Lookup)][:-1]  # those of `LumpedDamper` first, without the table
Scalars: Any = namedtuple("Scalars", NAMES)  # type: ignore[misc]
Numbers: Any = namedtuple("Numbers", NAMES + [f"table_{n}" for n in range(len(TABLE))])  # type: ignore[misc]
SIZE = len(NAMES)

PISTON, SPEED, BEND, SEAL, TEMPERATURE, COIL, HELD, ACTING, AIR = 0, 1, 2, 3, 4, 5, 6, 7, 8
STATE_SIZE = 9
STEP_S = 0.1e-3  # halving it changes the force by less than 1 % (test_lumped)
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
