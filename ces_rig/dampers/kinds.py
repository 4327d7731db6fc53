"""The kinds of damper: each is a package beside this file and an entry in `KINDS`.

A new kind needs parameters (a `LumpedDamper` if its description is flat), a kernel, effects, a live simulation and an
entry here; simulations, blind cases and the live rig then support it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any

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
from ces_rig.dampers.hydraulic.effects import Hydraulic
from ces_rig.dampers.hydraulic.parameters import Damper
from ces_rig.dampers.lumped import LumpedDamper
from ces_rig.dampers.monotube import effects as monotube
from ces_rig.dampers.monotube import kernel as monotube_kernel
from ces_rig.dampers.monotube import live as monotube_live
from ces_rig.dampers.monotube.parameters import Monotube
from ces_rig.dampers.polyviscous import effects as polyviscous
from ces_rig.dampers.polyviscous import kernel as polyviscous_kernel
from ces_rig.dampers.polyviscous import live as polyviscous_live
from ces_rig.dampers.polyviscous.parameters import Polyviscous
from ces_rig.descriptions import build
from ces_rig.errors import RigError
from ces_rig.nested_numbers import replace_numbers

Array = NDArray[np.float64]
HYDRAULIC = "hydraulic"
LUMPED: Mapping[str, type[LumpedDamper]] = {cls.kind: cls for cls in (BoucWen, Polyviscous, Monotube)}
DamperModel = Hydraulic | LumpedDamper
"""A damper whose numbers can be changed by path: as a plant, a simulation or on a live rig."""


@dataclass(frozen=True)
class DamperKind:
    """A kind of damper: its effect-free design, variation, simulation errors, effects and live kernels."""

    design: DamperModel
    varied: Mapping[str, float]
    wrong: Mapping[tuple[str, ...], float]
    spreads: Mapping[str, Proportions]
    changes: Mapping[str, Change]
    drive: Callable[..., None]
    ride: Callable[..., None]
    coil: int  # index of the coil current in the kernel's state
    temperature: int  # the same of the temperature
    step_s: float  # step of the integrator

    def draw_plant(self, rng: Generator) -> DamperModel:
        """Return the design with the numbers in `varied` drawn log-normally, each with its standard deviation."""
        factors = {path: float(np.exp(s * rng.standard_normal())) for path, s in self.varied.items()}
        return self.design.with_numbers({path: f * self.design.number(path) for path, f in factors.items()})

    def numbers(self, model: DamperModel, withheld: WithheldEffect) -> dict[str, float]:
        """Return the physical numbers of `model` under the effect, by path."""
        return self.changes[withheld.name](model.damper, withheld.severity, withheld.proportions)


def _kind(design: DamperModel, effects: ModuleType, kernel: ModuleType, live: ModuleType, step_s: float) -> DamperKind:
    return DamperKind(
        design,
        effects.VARIED,
        effects.WRONG,
        effects.SPREADS,
        effects.CHANGES,
        live.drive,
        live.ride,
        kernel.COIL,
        kernel.TEMPERATURE,
        step_s,
    )


KINDS: Mapping[str, DamperKind] = {
    HYDRAULIC: _kind(
        Hydraulic(replace_numbers(Damper(), hydraulic.DESIGN)), hydraulic, hydraulic_kernel, hydraulic_live,
        stepper.STEP_S,
    ),
    BoucWen.kind: _kind(BoucWen(), bouc_wen, bouc_wen_kernel, bouc_wen_live, lumped.STEP_S),
    Polyviscous.kind: _kind(Polyviscous(), polyviscous, polyviscous_kernel, polyviscous_live, lumped.STEP_S),
    Monotube.kind: _kind(Monotube(), monotube, monotube_kernel, monotube_live, lumped.STEP_S),
}  # fmt: skip


def read_lumped(description: dict[str, Any], where: str) -> LumpedDamper | None:
    """Remove `kind` from a description; return its damper if the description is flat, None for a hydraulic damper.

    Raises RigError for an unknown kind or a number out of range.
    """
    kind = description.pop("kind", HYDRAULIC)
    if kind in LUMPED:
        return build(LUMPED[kind], description, where)
    if kind != HYDRAULIC:
        raise RigError(f"{where}: kind is {kind!r}; expected one of {', '.join(KINDS)}")
    return None
