"""A stroke read from a CSV file: columns `time_s` and `position_m`; others are ignored."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ces_rig.errors import RigError

Array = NDArray[np.float64]

COLUMNS = ("time_s", "position_m")
MAX_ROWS = 10_000_000
MIN_ROWS = 4


@dataclass(frozen=True)
class StrokeFile:
    """The cubic spline through the file's samples; before the first and after the last sample it rests there.

    `table` raises RigError for a file that is no stroke.
    """

    path: str = field(metadata={"unit": "", "what": "CSV file"})

    @cached_property
    def table(self) -> tuple[Array, Array]:
        """Times [s] and positions [m], each (n,)."""
        return read_stroke_file(Path(self.path))

    def samples(self, time_s: Array, rng: Generator) -> Array:
        """Return the position [m] at the times (n,)."""
        return interpolate_stroke(*self.table, time_s)


@dataclass(frozen=True)
class SampledStroke:
    """A stroke held in memory: times [s], rising, and positions [m], each (n,)."""

    times_s: Array
    positions_m: Array

    def samples(self, time_s: Array, rng: Generator) -> Array:
        """Return the position [m] at the times (n,)."""
        return interpolate_stroke(self.times_s, self.positions_m, time_s)


def interpolate_stroke(times_s: Array, positions_m: Array, at_s: Array) -> Array:
    """Return the cubic spline through the samples at `at_s` (n,), at rest outside them."""
    return np.asarray(CubicSpline(times_s, positions_m)(np.clip(at_s, times_s[0], times_s[-1])))


def read_stroke_file(path: Path) -> tuple[Array, Array]:
    """Return times [s] and positions [m] of a stroke file; raises RigError naming the line."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = np.array(list(_rows(csv.reader(file), path)))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise RigError(f"{path}: cannot be read as CSV: {error}; expected the columns {', '.join(COLUMNS)}") from None
    if len(rows) < MIN_ROWS:
        raise RigError(f"{path}: {len(rows)} samples; expected at least {MIN_ROWS}")
    late = np.flatnonzero(np.diff(rows[:, 0]) <= 0.0)
    if len(late):
        raise RigError(f"{path}:{late[0] + 3}: time_s does not rise; expected increasing times")
    return rows[:, 0], rows[:, 1]


def _rows(lines: Iterator[list[str]], path: Path) -> Iterator[tuple[float, float]]:
    head = [name.strip() for name in next(lines, [])]
    if any(name not in head for name in COLUMNS):
        raise RigError(f"{path}: columns are {', '.join(head)[:200] or 'none'}; expected {', '.join(COLUMNS)}")
    at = [head.index(name) for name in COLUMNS]
    for number, cells in enumerate(islice(lines, MAX_ROWS + 1), 2):
        if number > MAX_ROWS + 1:
            raise RigError(f"{path}: more than {MAX_ROWS} samples; expected a shorter stroke")
        if cells:
            yield _numbers(cells, at, f"{path}:{number}")


def _numbers(cells: list[str], at: list[int], where: str) -> tuple[float, float]:
    try:
        time, position = (float(cells[i]) for i in at)
    except (ValueError, IndexError):
        raise RigError(f"{where}: {','.join(cells)[:60]!r}; expected numbers in {', '.join(COLUMNS)}") from None
    if not np.isfinite([time, position]).all():
        raise RigError(f"{where}: {','.join(cells)[:60]!r} is not finite; expected numbers")
    return time, position
