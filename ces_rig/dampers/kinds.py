"""The kinds of damper, each a folder beside this file and one row of `KINDS`.

A new kind needs its parameters (for a flat description, a `LumpedDamper`), its kernel, its effects, its chunks for a
live rig, and a row here: recordings, simulations, blind cases and the live rig then have it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Protocol, Self

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from ces_rig.dampers import lumped
from ces_rig.dampers.bouc_wen import effects as bouc_wen
from ces_rig.dampers.bouc_wen import kernel as bouc_wen_kernel
from ces_rig.dampers.bouc_wen import live as bouc_wen_live
from ces_rig.dampers.bouc_wen.parameters import BoucWen
from ces_rig.dampers.effects import Change, Proportions, WithheldEffect
from ces_rig.dampers.hydraulic import effects as hydraulic
from ces_rig.dampers.hydraulic import kernel as hydraulic_kernel
from ces_rig.dampers.hydraulic import live as hydraulic_live
from ces_rig.dampers.hydraulic import stepper
from ces_rig.dampers.hydraulic.parameters import Damper
from ces_rig.dampers.lumped import LumpedDamper
from ces_rig.dampers.polyviscous import effects as polyviscous
from ces_rig.dampers.polyviscous import kernel as polyviscous_kernel
from ces_rig.dampers.polyviscous import live as polyviscous_live
from ces_rig.dampers.polyviscous.parameters import Polyviscous
from ces_rig.descriptions import build
from ces_rig.errors import RigError
from ces_rig.nested_numbers import replace_numbers

Array = NDArray[np.float64]
HYDRAULIC = "hydraulic"
LUMPED: Mapping[str, type[LumpedDamper]] = {cls.kind: cls for cls in (BoucWen, Polyviscous)}


class DamperModel(Protocol):
    """A damper with numbers that can be changed by path, as a plant, a simulation or on a live rig."""

    @property
    def damper(self) -> Any:
        """The description that effects change."""

    @property
    def current_A(self) -> tuple[float, float]:
        """The range [A] of the current that acts."""

    @property
    def reach_m(self) -> float:
        """Travel [m] from mid-stroke to either end."""

    @property
    def delay_s(self) -> float:
        """Dead time [s] of the current."""

    def run(self, interval_s: float, stroke_m: Array, current_A: Array) -> tuple[Array, Array, Array]:
        """Return tared force [N], coil current [A] and temperature [°C], each (n,)."""

    def coefficients(self) -> Array:
        """Return the kernel's numbers."""

    def settle(self, stroke_m: float, speed_m_s: float, current_A: float) -> tuple[Array, float]:
        """Return the kernel's state at rest at this input and the tared force [N] there."""

    def without_coil(self) -> Self:
        """Return the damper as driven with a measured coil current."""

    def with_numbers(self, numbers: Mapping[str, float]) -> Self:
        """Return the damper with other numbers; raises RigError for one that no real damper has."""

    def number(self, path: str) -> float:
        """Return the number at a path."""

    def description(self) -> dict[str, Any]:
        """Return what its YAML file holds."""


@dataclass(frozen=True)
class DamperKind:
    """A kind of damper: its effect-free design, what varies and what a simulation has wrong, effects, live kernels."""

    design: Any  # a DamperModel
    current_A: tuple[float, float]
    varied: Mapping[str, float]
    wrong: Mapping[tuple[str, ...], float]
    spreads: Mapping[str, Proportions]
    changes: Mapping[str, Change]
    drive: Callable[..., None]
    ride: Callable[..., None]
    coil: int  # where the kernel's state keeps the coil's current
    step_s: float  # of the integrator

    def draw_plant(self, rng: Generator) -> Any:
        """Return the design with the numbers `varied` drawn log-normal, each with its standard deviation."""
        factors = {path: float(np.exp(s * rng.standard_normal())) for path, s in self.varied.items()}
        return self.design.with_numbers({path: f * self.design.number(path) for path, f in factors.items()})

    def numbers(self, model: DamperModel, withheld: WithheldEffect) -> dict[str, float]:
        """Return the physical numbers of `model` under the effect, by path."""
        return self.changes[withheld.name](model.damper, withheld.severity, withheld.proportions)


def _kind(design: Any, effects: ModuleType, kernel: ModuleType, live: ModuleType, step_s: float) -> DamperKind:
    return DamperKind(
        design, design.current_A, effects.VARIED, effects.WRONG, effects.SPREADS, effects.CHANGES,
        live.drive, live.ride, kernel.COIL, step_s,
    )  # fmt: skip


KINDS: Mapping[str, DamperKind] = {
    HYDRAULIC: _kind(
        hydraulic.Hydraulic(replace_numbers(Damper(), hydraulic.DESIGN)), hydraulic, hydraulic_kernel, hydraulic_live,
        stepper.STEP_S,
    ),
    BoucWen.kind: _kind(BoucWen(), bouc_wen, bouc_wen_kernel, bouc_wen_live, lumped.STEP_S),
    Polyviscous.kind: _kind(Polyviscous(), polyviscous, polyviscous_kernel, polyviscous_live, lumped.STEP_S),
}  # fmt: skip


def read_lumped(given: dict[str, Any], where: str) -> LumpedDamper | None:
    """Take `kind` out of a description; return its damper if that is flat, None for the hydraulic one's sections.

    Raises RigError for an unknown kind or a number out of range.
    """
    kind = given.pop("kind", HYDRAULIC)
    if kind in LUMPED:
        return build(LUMPED[kind], given, where)
    if kind != HYDRAULIC:
        raise RigError(f"{where}: kind is {kind!r}; expected one of {', '.join(KINDS)}")
    return None
