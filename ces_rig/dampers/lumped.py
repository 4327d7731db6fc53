"""Base of the dampers with a flat description (no sections), and the effects that they have in common.

Each kind is a package: the fields of its dataclass (`parameters`), its equations (`kernel`), the changes that its
effects make (`effects`) and its live simulation (`live`); `ces_rig/dampers/kinds.py` lists it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, astuple, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from ces_rig.dampers.effects import Change, Proportions, log_spread, uniform_spread
from ces_rig.dampers.hydraulic.stepper import spline_speed
from ces_rig.errors import RigError
from ces_rig.nested_numbers import get_number, replace_numbers

Array = NDArray[np.float64]
STEP_S = 0.1e-3  # halving it changes the force by less than 1 % (test_withheld_kernels)
REACH_M = 0.06  # [m] travel to either side for which the gas volume is designed
MIN_GAS_SHARE = 1.05  # of the volume that the rod displaces at the end of that travel


class LumpedDamper(ABC):
    """Base of the frozen dataclasses; raises RigError if a number is out of range."""

    kind: ClassVar[str]
    current_A: ClassVar[tuple[float, float]]  # [A] working range of the current
    reach_m: ClassVar[float] = REACH_M
    delay_s: float = 0.0  # [s] dead time of the current, for kinds without this field
    gas_m3: float
    rod_m2: float
    coil_s: float

    def __post_init__(self) -> None:
        if self.gas_m3 <= MIN_GAS_SHARE * self.rod_m2 * REACH_M:
            raise RigError(f"{self.kind}: gas_m3 {self.gas_m3:g} cannot take up the rod's volume; enlarge it")

    @property
    def damper(self) -> Self:
        """The description that the effects change: this object."""
        return self

    @property
    def allowed_A(self) -> tuple[float, float]:
        """The range [A] that a driver clips commands to: the working range."""
        return self.current_A

    def run(self, interval_s: float, stroke_m: Array, current_A: Array) -> tuple[Array, Array, Array]:
        """Return force [N], tared at mid-stroke, coil current [A] and temperature [°C], each (n,)."""
        stroke, current = (np.ascontiguousarray(a, dtype=np.float64) for a in (stroke_m, current_A))
        time = np.arange(len(stroke), dtype=np.float64) * interval_s
        out = np.empty((3, len(stroke)))
        substeps = max(1, round(interval_s / STEP_S))
        self._simulate(time, (stroke, spline_speed(time, stroke), current), interval_s, substeps, out)
        return out[0], out[1], out[2]

    @abstractmethod
    def _simulate(
        self, time_s: Array, moves: tuple[Array, Array, Array], interval_s: float, substeps: int, out: Array
    ) -> None:
        """Run the kernel from rest through stroke, speed and current, each (n,); fills `out` (3, n)."""

    @abstractmethod
    def settle(self, stroke_m: float, speed_m_s: float, current_A: float) -> tuple[Array, float]:
        """Return the kernel's state at rest at this input and the force [N] there, tared at mid-stroke."""

    def coefficients(self) -> Array:
        """Return the kernel's numbers."""
        return np.array(astuple(self))  # type: ignore[call-overload]

    def without_coil(self) -> Self:
        """Return the damper without its coil's lag, to be driven with a measured coil current."""
        return replace(self, coil_s=0.0)  # type: ignore[type-var]

    def with_numbers(self, numbers: Mapping[str, float]) -> Self:
        """Return the damper with other numbers; raises RigError for one out of range."""
        return replace_numbers(self, numbers, f"{self.kind} plant")

    def number(self, path: str) -> float:
        """Return the number of this name."""
        return get_number(self, path)

    def description(self) -> dict[str, Any]:
        """Return the contents of its YAML file."""
        return {"kind": self.kind, **asdict(self)}  # type: ignore[call-overload]


LUMPED_SPREADS: Mapping[str, Proportions] = {
    "inertia": {"mass_kg": log_spread(1.5, 4.0)},
    "groove": {"bypass_m_Ns": log_spread(6e-5, 2e-4), "at_m": uniform_spread(-0.012, 0.012),
               "half_m": log_spread(0.004, 0.01)},
    "side_load": {"slope_N_m": log_spread(2e3, 5e3), "at_m": uniform_spread(-0.01, 0.01)},
}  # fmt: skip


def gas_spring(d: Any, s: float, p: Mapping[str, float]) -> dict[str, float]:
    """Return the numbers of a gas with more pressure and less volume, still large enough for the rod."""
    smallest = 1.2 * d.rod_m2 * REACH_M
    return {
        "gas_Pa": d.gas_Pa * (1.0 + s * p["pressure"]),
        "gas_m3": smallest + (d.gas_m3 - smallest) / (1.0 + s * p["volume"]),
    }


LUMPED_CHANGES: Mapping[str, Change] = {
    "inertia": lambda d, s, p: {"mass_kg": d.mass_kg + s * p["mass_kg"]},
    "gas_spring": gas_spring,
    "blow_off": lambda d, s, p: {"relief_N": d.relief_N / (1.0 + s * p["weakness"]), "relief_Ns_m": p["beyond_Ns_m"]},
    "groove": lambda _d, s, p: {
        "groove_m_Ns": s * p["bypass_m_Ns"], "groove_at_m": p["at_m"], "groove_m": p["half_m"],
    },
    "foaming": lambda _d, s, p: {"foaming_1_J": s * p["growth_m_J"]},
    "side_load": lambda _d, s, p: {"side_load_N_m": s * p["slope_N_m"], "side_at_m": p["at_m"]},
}  # fmt: skip
