"""What a rig and its damper allow: stroke, speed, acceleration, bandwidth, current, and heat."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import exp

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from ces_iterate.commands import Commands
from ces_iterate.errors import IterateError
from ces_rig.descriptions import REQUIRED, quantity

F = NDArray[np.float64]

TOLERANCE = 1e-6  # relative: rounding of the file's digits


@dataclass(frozen=True)
class HeatLimits:
    """How much dissipated power the damper stands.

    The load is the dissipated power [W] behind a first-order low-pass of `memory_s`, the time constant with which the
    damper cools; it is proportional to the rise of temperature of a body of one heat capacity. Before there is a model,
    the dissipated power is bounded by `force_N` times the speed. With 0, `power_W` sets no limit.
    """

    power_W: float = quantity(0.0, "W", "largest load; 0: no limit", 0.0, 1e5)
    memory_s: float = quantity(120.0, "s", "time constant of cooling", 1.0, 1e5)
    force_N: float = quantity(1500.0, "N", "RMS force to expect before there is a model", 1.0, 1e6)

    def load_after(self, load_W: float, power_W: F, interval_s: float) -> F:
        """Return the load [W] (n,) after each `interval_s` of dissipated power (n,), from a load at the start."""
        decay = exp(-interval_s / self.memory_s)
        n = np.arange(1, len(power_W) + 1)
        return np.asarray(load_W * decay**n + lfilter([1.0 - decay], [1.0, -decay], power_W))

    def cool_down_s(self, load_W: float, wanted_W: float) -> float:
        """Return the rest [s] in which a load falls to `wanted_W`; 0 if it is not above."""
        return self.memory_s * float(np.log(load_W / wanted_W)) if load_W > wanted_W > 0.0 else 0.0


@dataclass(frozen=True)
class RigLimits:
    """The box that no experiment leaves. Strokes are measured from mid-stroke, `centre_m` on the rig's own scale."""

    stroke_m: float = quantity(REQUIRED, "m", "largest distance from centre_m", 0.0, 0.5, above=True)
    speed_m_s: float = quantity(REQUIRED, "m/s", "largest speed", 0.0, 20.0, above=True)
    acceleration_m_s2: float = quantity(REQUIRED, "m/s²", "largest acceleration", 0.0, 1e4, above=True)
    low_A: float = quantity(REQUIRED, "A", "lowest current", 0.0, 100.0)
    high_A: float = quantity(REQUIRED, "A", "highest current", 0.0, 100.0)
    frequency_Hz: float = quantity(15.0, "Hz", "highest frequency that the actuator follows", 0.5, 100.0)
    hold_s: float = quantity(0.03, "s", "shortest time between two steps of the current", 1e-3, 10.0)
    centre_m: float = quantity(0.0, "m", "position around which the strokes are designed", -1.0, 1.0)
    heat: HeatLimits = field(default_factory=HeatLimits)

    def __post_init__(self) -> None:
        if self.high_A < self.low_A:
            raise IterateError(f"limits: high_A {self.high_A:g} is below low_A {self.low_A:g}; exchange them")

    def excess(self, commands: Commands) -> Iterator[str]:
        """Yield a phrase for each limit that the commands do not keep; heat is checked by the loop."""
        speed, acceleration = commands.motion()
        peaks = {
            "stroke": (np.abs(commands.stroke_m - self.centre_m).max(), self.stroke_m, "m"),
            "speed": (np.abs(speed).max(), self.speed_m_s, "m/s"),
            "acceleration": (np.abs(acceleration).max(), self.acceleration_m_s2, "m/s²"),
        }
        for name, (peak, limit, unit) in peaks.items():
            if peak > limit * (1.0 + TOLERANCE):
                yield f"{name} {peak:.4g} {unit} exceeds {limit:g} {unit}"
        low, high = commands.current_A.min(), commands.current_A.max()
        if low < self.low_A - TOLERANCE or high > self.high_A + TOLERANCE:
            yield f"current {low:.4g} to {high:.4g} A leaves {self.low_A:g} to {self.high_A:g} A"

    def require_within(self, commands: Commands) -> Commands:
        """Return the commands; raises IterateError if they leave the limits. Every rig gets only what passed here."""
        found = "; ".join(self.excess(commands))
        if found:
            raise IterateError(f"{commands.name}: {found}; change the experiment or the plan's limits")
        return commands
