"""A damper known by a table: its force over speed and current, in series with a spring, and the parts around it.

The table is a dyno's result: the packaged one is made up, `learning.py` learns one from a recording. `kernel.py` holds
the equations.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import ClassVar

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
