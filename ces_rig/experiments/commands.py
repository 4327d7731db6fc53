"""What a rig is asked to do, and its limits: stroke and current on a uniform grid, written and read as CSV.

The speed between grid points is that of the cubic spline through the stroke, as everywhere on the virtual rig.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import exp
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from ces_data.arrays import F
from ces_observer.fields import REQUIRED
from ces_observer.json_text import write_atomically
from ces_observer.records import quantity
from ces_rig.errors import RigError
from ces_rig.limits import DesignLimits

INTERVAL_S = 1e-3  # [s] grid of all designed experiments
NEED = ("position", "current", "force")  # channels of every recording
HEADER = "time_s,stroke_m,current_A"
FORMAT = ("%.4f", "%.9f", "%.5f")


@dataclass(frozen=True)
class RigCommands:
    """Stroke [m] and current [A], each (n,), every `INTERVAL_S` from time 0; `name` is that of the recording.

    `seed` is for rigs that draw random numbers of their own, such as the noise of the virtual rig's sensors. Before
    the experiment the damper rests for `rest_s`, to cool down.
    """

    name: str
    stroke_m: F
    current_A: F
    seed: int = 1
    rest_s: float = 0.0

    def __post_init__(self) -> None:
        stroke, current = (np.asarray(a, dtype=np.float64) for a in (self.stroke_m, self.current_A))
        if stroke.ndim != 1 or stroke.shape != current.shape or len(stroke) < 2:
            raise RigError(f"{self.name}: {stroke.shape} strokes, {current.shape} currents; expected equal lengths")
        if not (np.isfinite(stroke).all() and np.isfinite(current).all()):
            raise RigError(f"{self.name}: a stroke or current is not a finite number; correct the file")
        object.__setattr__(self, "stroke_m", stroke)
        object.__setattr__(self, "current_A", current)

    @property
    def time_s(self) -> F:
        """Times [s] of the grid, (n,)."""
        return np.asarray(np.arange(len(self.stroke_m)) * INTERVAL_S, np.float64)

    @property
    def duration_s(self) -> float:
        """Seconds from the first to the last grid point."""
        return (len(self.stroke_m) - 1) * INTERVAL_S

    def motion(self) -> tuple[F, F]:
        """Return speed [m/s] and acceleration [m/s²] at the grid points, each (n,)."""
        spline = CubicSpline(self.time_s, self.stroke_m)
        return np.asarray(spline(self.time_s, 1)), np.asarray(spline(self.time_s, 2))

    def at(self, interval_s: float) -> tuple[F, F]:
        """Return stroke (cubic between the grid points) and current (held) every `interval_s`, each (m,)."""
        time = np.arange(round(self.duration_s / interval_s) + 1) * interval_s
        held = np.floor(time / INTERVAL_S + 1e-6).astype(int)
        return np.asarray(CubicSpline(self.time_s, self.stroke_m)(time)), self.current_A[held]

    def repeat(self, name: str, seed: int, rest_s: float) -> RigCommands:
        """Return the same stroke and current under another name and seed, after another rest."""
        return replace(self, name=name, seed=seed, rest_s=rest_s)


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
            raise RigError(f"high_A {self.high_A:g} is below low_A {self.low_A:g}; exchange them")

    def excess(self, commands: RigCommands) -> Iterator[str]:
        """Yield a phrase for each limit that the commands do not keep; heat is checked by the loop."""
        speed, acceleration = commands.motion()
        peaks = {
            "stroke": (np.abs(commands.stroke_m - self.centre_m).max(), self.stroke_m, "m"),
            "speed": (np.abs(speed).max(), self.speed_m_s, "m/s"),
            "acceleration": (np.abs(acceleration).max(), self.acceleration_m_s2, "m/s²"),
        }
        for name, (peak, limit, unit) in peaks.items():
            if peak > limit * (1.0 + DesignLimits.TOLERANCE):
                yield f"{name} {peak:.4g} {unit} exceeds {limit:g} {unit}"
        low, high = commands.current_A.min(), commands.current_A.max()
        if low < self.low_A - DesignLimits.TOLERANCE or high > self.high_A + DesignLimits.TOLERANCE:
            yield f"current {low:.4g} to {high:.4g} A leaves {self.low_A:g} to {self.high_A:g} A"

    def require_within(self, commands: RigCommands) -> RigCommands:
        """Return the commands; raises RigError if they leave the limits. Every rig gets only what passed here."""
        found = "; ".join(self.excess(commands))
        if found:
            raise RigError(f"{commands.name}: {found}; change the experiment or the plan's limits")
        return commands


def write_commands(path: Path, commands: RigCommands) -> None:
    """Write a CSV file with the columns of `HEADER`; it is complete or not there at all."""
    text = io.StringIO()
    rows = np.column_stack([commands.time_s, commands.stroke_m, commands.current_A])
    np.savetxt(text, rows, fmt=FORMAT, delimiter=",", header=HEADER, comments="")
    write_atomically(path, text.getvalue())


def read_commands(path: Path) -> RigCommands:
    """Return the commands of a CSV file; raises RigError naming the file and what is wrong."""
    try:
        with path.open(encoding="utf-8") as file:
            header = file.readline().strip()
            rows = np.loadtxt(file, delimiter=",", ndmin=2)
    except OSError as error:
        raise RigError(f"{path}: cannot be read: {error.strerror}; expected columns {HEADER}") from None
    except ValueError as error:
        raise RigError(f"{path}: {str(error).splitlines()[0]}; expected rows of three numbers: {HEADER}") from None
    if header != HEADER or rows.shape[1:] != (3,):
        raise RigError(f"{path}: the first line is '{header[:60]}'; expected {HEADER}")
    if np.abs(rows[:, 0] - np.arange(len(rows)) * INTERVAL_S).max() > 0.1 * INTERVAL_S:
        raise RigError(f"{path}: times are not every {INTERVAL_S:g} s from 0; resample the experiment")
    return RigCommands(path.stem, rows[:, 1], rows[:, 2])
