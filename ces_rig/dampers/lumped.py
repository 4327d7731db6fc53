"""A damper whose description is flat, as a plant: numbers by name, drawn and changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from ces_rig.parts import put, value

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Lumped:
    """A `BoucWen` or `Polyviscous` damper of the `kind` that its description names."""

    kind: str
    damper: Any

    def run(self, interval_s: float, stroke_m: Array, current_A: Array) -> tuple[Array, Array, Array]:
        """Return tared force [N], coil current [A] and temperature [°C], each (n,)."""
        force, coil, temperature = self.damper.run(interval_s, stroke_m, current_A)
        return force, coil, temperature

    def without_coil(self) -> Lumped:
        """Return the damper as driven with a measured coil current."""
        return Lumped(self.kind, self.damper.without_coil())

    def changed(self, numbers: Mapping[str, float]) -> Lumped:
        """Return the damper with other numbers; raises RigError for one out of range."""
        return Lumped(self.kind, put(self.damper, numbers, f"{self.kind} plant"))

    def number(self, path: str) -> float:
        """Return the number of this name."""
        return value(self.damper, path)

    def description(self) -> dict[str, Any]:
        """Return what its YAML file holds."""
        return {"kind": self.kind, **asdict(self.damper)}


def drawn(plain: Lumped, varied: Mapping[str, float], rng: Generator) -> Lumped:
    """Return `plain` with the numbers `varied` drawn log-normal, each with its standard deviation."""
    factors = {name: float(np.exp(s * rng.standard_normal())) for name, s in varied.items()}
    return plain.changed({name: f * plain.number(name) for name, f in factors.items()})


def grown(start: float, target: float, share: float) -> float:
    """Return a number on its way from the plant's own to the effect's, geometrically."""
    return float(start ** (1.0 - share) * target**share)
