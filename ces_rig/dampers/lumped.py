"""A damper whose description is flat: the skeleton of its simulation and its life as a plant, and common effects.

A kind of such a damper is a folder: the fields of its dataclass (`parameters`), the equations (`kernel`), what the
effects change (`effects`) and how a live rig drives it (`live`); `ces_rig/dampers/kinds.py` lists it.
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
REACH_M = 0.06  # [m] the stroke to either side that the gas is made for
MIN_GAS_SHARE = 1.05  # of the volume that the rod takes at the end of that stroke


class LumpedDamper(ABC):
    """Base of the frozen dataclasses; raises RigError if a number is out of range."""

    kind: ClassVar[str]
    current_A: ClassVar[tuple[float, float]]  # the range [A] of the current that acts
    reach_m: ClassVar[float] = REACH_M
    delay_s: float = 0.0  # dead time of the current, for a kind that has no such field
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

    def run(self, interval_s: float, stroke_m: Array, current_A: Array) -> tuple[Array, Array, Array]:
        """Return force [N] without the gas force at mid-stroke, coil current [A], temperature [°C], each (n,)."""
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
        """Run the kernel from rest through stroke, speed and current, each (n,); fills `out` (3, n) as `run` says."""

    @abstractmethod
    def settle(self, stroke_m: float, speed_m_s: float, current_A: float) -> tuple[Array, float]:
        """Return the kernel's state at rest at this input and the force [N] there, tared at mid-stroke."""

    def coefficients(self) -> Array:
        """Return the kernel's numbers."""
        return np.array(astuple(self))  # type: ignore[call-overload]

    def without_coil(self) -> Self:
        """Return the damper as driven with a measured coil current."""
        return replace(self, coil_s=0.0)  # type: ignore[type-var]

    def with_numbers(self, numbers: Mapping[str, float]) -> Self:
        """Return the damper with other numbers; raises RigError for one out of range."""
        return replace_numbers(self, numbers, f"{self.kind} plant")

    def number(self, path: str) -> float:
        """Return the number of this name."""
        return get_number(self, path)

    def description(self) -> dict[str, Any]:
        """Return what its YAML file holds."""
        return {"kind": self.kind, **asdict(self)}  # type: ignore[call-overload]


LUMPED_SPREADS: Mapping[str, Proportions] = {
    "inertia": {"mass_kg": log_spread(1.5, 4.0)},
    "groove": {"bypass_m_Ns": log_spread(6e-5, 2e-4), "at_m": uniform_spread(-0.012, 0.012),
    "half_m": log_spread(0.004, 0.01)},
    "side_load": {"slope_N_m": log_spread(2e3, 5e3), "at_m": uniform_spread(-0.01, 0.01)},
}  # fmt: skip


def gas_spring(d: Any, s: float, p: Mapping[str, float]) -> dict[str, float]:
    """Return the gas under more pressure in less volume, which still takes up the rod."""
    smallest = 1.2 * d.rod_m2 * REACH_M
    return {
        "gas_Pa": d.gas_Pa * (1.0 + s * p["pressure"]),
        "gas_m3": smallest + (d.gas_m3 - smallest) / (1.0 + s * p["volume"]),
    }


def blow_off(d: Any, s: float, p: Mapping[str, float]) -> dict[str, float]:
    """Return a relief valve that opens sooner."""
    return {"relief_N": d.relief_N / (1.0 + s * p["weakness"]), "relief_Ns_m": p["beyond_Ns_m"]}


def inertia(d: Any, s: float, p: Mapping[str, float]) -> dict[str, float]:
    """Return a heavier rod."""
    return {"mass_kg": d.mass_kg + s * p["mass_kg"]}


def groove(_d: Any, s: float, p: Mapping[str, float]) -> dict[str, float]:
    """Return a groove in the wall."""
    return {"groove_m_Ns": s * p["bypass_m_Ns"], "groove_at_m": p["at_m"], "groove_m": p["half_m"]}


def foaming(_d: Any, s: float, p: Mapping[str, float]) -> dict[str, float]:
    """Return air that grows with the energy taken up."""
    return {"foaming_1_J": s * p["growth_m_J"]}


def side_load(_d: Any, s: float, p: Mapping[str, float]) -> dict[str, float]:
    """Return friction that grows away from one stroke."""
    return {"side_load_N_m": s * p["slope_N_m"], "side_at_m": p["at_m"]}


LUMPED_CHANGES: Mapping[str, Change] = {
    "inertia": inertia, "gas_spring": gas_spring, "blow_off": blow_off, "groove": groove, "foaming": foaming,
    "side_load": side_load,
}  # fmt: skip
