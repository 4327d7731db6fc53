"""A damper known by a table: its force over speed and current, in series with a spring, and the parts around it.

The table is a dyno's result: the packaged one is made up, `learn` makes one of a recording. `kernel.py` holds
the equations.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
from itertools import product
from typing import ClassVar

import numpy as np
from scipy.signal import butter, lfilter, sosfiltfilt

from ces_data.arrays import F
from ces_data.recording import Recording
from ces_observer.records import quantity
from ces_rig.dampers.model import LumpedDamper
from ces_rig.errors import RigError

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


STEP_S = 1e-3
SMOOTHING_HZ = 40.0
LAGS_S = (1e-3, 2e-3, 4e-3, 7e-3, 12e-3, 20e-3)
STIFFNESSES_N_m = (5e5, 1e6, 2e6, 4e6, 8e6, 2e7)
SMOOTHNESS = 0.02  # weight of the differences between neighbours in the table
MIN_CURRENTS_A = 0.05  # range
MIN_EXPLAINED = 0.7  # share of the force's variance
ZERO = SPEEDS.index(0.0)


def learn_lookup(recording: Recording) -> Lookup:
    """Return the damper; raises RigError if the force of the recording does not follow its speed and current."""
    speed, force, current = _read_signals(recording)
    low, high = (float(value) for value in np.percentile(current, [1.0, 99.0]))
    if high - low < MIN_CURRENTS_A:
        raise RigError(f"{recording.name}: currents from {low:.3g} to {high:.3g} A; expected several, to learn a map")
    largest = float(np.percentile(np.abs(speed), 99.5))
    rate, best = np.gradient(force, STEP_S), (np.inf, 0.0, 0.0, np.zeros(0))
    for lag, stiffness in product(LAGS_S, STIFFNESSES_N_m):
        kept = float(np.exp(-STEP_S / lag))
        acting = lfilter([1.0 - kept], [1.0, -kept], current, zi=[kept * current[0]])[0]
        share = (acting - low) / (high - low) * (LEVELS - 1)
        table, left = _fit_table((speed - rate / stiffness) / largest, share, force)
        best = min(best, (left, lag, stiffness, table), key=lambda one: one[0])
    left, lag, stiffness, table = best
    if left > 1.0 - MIN_EXPLAINED:
        raise RigError(
            f"{recording.name}: speed and current explain {max(1.0 - left, 0.0):.0%} of its force; expected at least "
            f"{MIN_EXPLAINED:.0%}; check signs and delays"
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
    grid = np.arange(start, end, round(1e9 * STEP_S))
    position, force, current = (np.interp(grid, c.stamps_ns, c.values) for c in channels)
    sos = butter(2, SMOOTHING_HZ, fs=1.0 / STEP_S, output="sos")
    return np.gradient(sosfiltfilt(sos, position), STEP_S), sosfiltfilt(sos, force), current


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
