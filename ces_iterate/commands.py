"""What a rig is asked to do: stroke and current on a uniform grid, checked once, written and read as CSV.

The speed between grid points is that of the cubic spline through the stroke, as everywhere on the virtual rig.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from ces_data.arrays import F
from ces_iterate.errors import IterateError
from ces_observer.json_text import write_atomically

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
            raise IterateError(f"{self.name}: {stroke.shape} strokes, {current.shape} currents; expected equal lengths")
        if not (np.isfinite(stroke).all() and np.isfinite(current).all()):
            raise IterateError(f"{self.name}: a stroke or current is not a finite number; correct the file")
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


def write_commands(path: Path, commands: RigCommands) -> None:
    """Write a CSV file with the columns of `HEADER`; it is complete or not there at all."""
    text = io.StringIO()
    rows = np.column_stack([commands.time_s, commands.stroke_m, commands.current_A])
    np.savetxt(text, rows, fmt=FORMAT, delimiter=",", header=HEADER, comments="")
    write_atomically(path, text.getvalue())


def read_commands(path: Path) -> RigCommands:
    """Return the commands of a CSV file; raises IterateError naming the file and what is wrong."""
    try:
        with path.open(encoding="utf-8") as file:
            header = file.readline().strip()
            rows = np.loadtxt(file, delimiter=",", ndmin=2)
    except OSError as error:
        raise IterateError(f"{path}: cannot be read: {error.strerror}; expected columns {HEADER}") from None
    except ValueError as error:
        raise IterateError(f"{path}: {str(error).splitlines()[0]}; expected rows of three numbers: {HEADER}") from None
    if header != HEADER or rows.shape[1:] != (3,):
        raise IterateError(f"{path}: the first line is '{header[:60]}'; expected {HEADER}")
    if np.abs(rows[:, 0] - np.arange(len(rows)) * INTERVAL_S).max() > 0.1 * INTERVAL_S:
        raise IterateError(f"{path}: times are not every {INTERVAL_S:g} s from 0; resample the experiment")
    return RigCommands(path.stem, rows[:, 1], rows[:, 2])
