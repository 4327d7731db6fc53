"""Withheld effects: their names, and how one is drawn, scaled and kept.

An effect is a severity and proportions. The proportions, drawn at random, say what shape it has in this case (how much
Stribeck beside how much Coulomb friction); all its physical numbers grow from the plant's own with the severity.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import exp, isfinite, log
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
    "current_crosstalk", "mains_hum", "position_wave",
)  # fmt: skip


@dataclass(frozen=True)
class Spread:
    """How a proportion is drawn: log-uniform in [low, high] (`signed`: either sign), or uniform."""

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


Proportions = Mapping[str, Spread]
Change = Callable[[Any, float, Mapping[str, float]], dict[str, float]]
"""(description of the damper, severity, proportions) -> the description's numbers under the effect, by path."""


@dataclass(frozen=True)
class WithheldEffect:
    """An effect put into a plant: severity 0 is none; raises RigError for an unknown name or a negative severity."""

    name: str
    severity: float
    proportions: Mapping[str, float]

    def __post_init__(self) -> None:
        if self.name not in EFFECTS + OUTSIDE:
            raise RigError(f"withheld effect '{self.name}' is unknown; known are {', '.join(EFFECTS + OUTSIDE)}")
        if not (isfinite(self.severity) and self.severity >= 0.0):
            raise RigError(f"withheld effect {self.name}: severity {self.severity!r}; expected a number from 0 on")


def with_severity(withheld: WithheldEffect, severity: float) -> WithheldEffect:
    """Return the same effect, of the same proportions, at another severity."""
    return replace(withheld, severity=severity)


def log_spread(low: float, high: float) -> Spread:
    """Return a log-uniform spread."""
    return Spread(low, high)


def uniform_spread(low: float, high: float) -> Spread:
    """Return a uniform spread."""
    return Spread(low, high, uniform=True)


def signed_spread(low: float, high: float) -> Spread:
    """Return a spread of either sign, log-uniform in magnitude."""
    return Spread(low, high, signed=True)


def interpolate_log(start: float, target: float, share: float) -> float:
    """Return a number on its way from the plant's own to the effect's, geometrically."""
    return float(start ** (1.0 - share) * target**share)
