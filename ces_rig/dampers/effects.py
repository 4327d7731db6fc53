"""Withheld effects: their names, and what an effect consists of.

An effect has a severity and proportions. The proportions, drawn at random, set its shape in one case (such as the ratio
of Stribeck to Coulomb friction); its physical numbers depart from the plant's own as the severity grows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial, reduce
from math import exp, isfinite, log, sqrt
from typing import Any

from numpy.random import Generator

from ces_rig.errors import RigError

EFFECTS = (
    "friction", "compressibility", "mount_compliance", "backlash", "inertia", "gas_spring", "cavitation",
    "temperature_fade", "leakage", "blow_off", "bump_stop", "valve_lag", "current_hysteresis", "current_scale",
    "force_offset", "force_drift", "force_scale", "position_delay",
)  # fmt: skip
OUTSIDE = (
    "groove", "foaming", "side_load", "sticking_check", "ring_tilt", "cell_resonance", "cell_creep",
    "current_crosstalk", "mains_hum", "position_wave", "late_check", "sticking_pilot", "current_ripple",
    "frame_resonance",
)  # fmt: skip


@dataclass(frozen=True)
class Spread:
    """Distribution of a proportion: log-uniform in [low, high] (`signed`: of either sign), or uniform."""

    low: float
    high: float
    uniform: bool = False
    signed: bool = False

    def draw(self, rng: Generator) -> float:
        """Return one value."""
        if self.uniform:
            return float(rng.uniform(self.low, self.high))
        value = exp(rng.uniform(log(self.low), log(self.high)))
        return -value if self.signed and rng.random() < 0.5 else value

    @property
    def middle(self) -> float:
        """The middle of the spread."""
        return 0.5 * (self.low + self.high) if self.uniform else sqrt(self.low * self.high)


log_spread, uniform_spread, signed_spread = Spread, partial(Spread, uniform=True), partial(Spread, signed=True)
Proportions = Mapping[str, Spread]
Change = Callable[[Any, float, Mapping[str, float]], dict[str, float]]
"""(damper description, severity, proportions) -> the numbers that the effect changes in it, by path."""


@dataclass(frozen=True)
class WithheldEffect:
    """An effect put into a plant: severity 0 is none; raises RigError for an unknown name or a negative severity."""

    name: str
    severity: float
    proportions: Mapping[str, float]

    def __post_init__(self) -> None:
        if self.name not in EFFECTS + OUTSIDE:
            raise RigError(f"withheld effect '{self.name}' is unknown; expected one of {', '.join(EFFECTS + OUTSIDE)}")
        if not (isfinite(self.severity) and self.severity >= 0.0):
            raise RigError(f"withheld effect {self.name}: severity {self.severity!r}; expected a number of at least 0")


def add_to(**paths: str) -> Change:
    """Return a change that adds to the numbers at `paths` the severity times a proportion, the name of the argument."""
    return lambda d, s, p: {path: get_number(d, path) + s * p[key] for key, path in paths.items()}


def get_number(damper: object, path: str) -> float:
    """Return the number at a path, such as `seal.coulomb_N`, in a damper's description."""
    return float(reduce(getattr, path.split("."), damper))  # type: ignore[arg-type]


def interpolate_log(start: float, target: float, share: float) -> float:
    """Return the geometric interpolation from `start` (share 0) to `target` (share 1)."""
    return float(start ** (1.0 - share) * target**share)
