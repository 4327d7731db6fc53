"""What strokes and currents are, how those of a sequence follow one another, and strokes that are made of samples.

The parts of a sequence, such as the test points of a dyno, follow one another, each with a duration and times of its
own; after the last part the sequence begins again. A stroke file holds the samples of a stroke.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from math import isfinite
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.random import Generator
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfilt

from ces_data.arrays import F
from ces_observer.errors import CesError
from ces_observer.fields import REQUIRED
from ces_observer.records import part, quantity

T = TypeVar("T")
Parts = Sequence[tuple[float, T]]  # duration [s] and shape of each part

KIND = "sequence"
MAX_PARTS = 1000


class Shape(Protocol):
    """A kind of stroke."""

    def samples(self, time_s: F, rng: Generator) -> F:
        """Return the position [m] at the uniform times, shape (n,), before fading and offset."""


class Current(Protocol):
    """A kind of current that is known before the damper moves."""

    def samples(self, time_s: F, stroke_m: F, rng: Generator) -> F:
        """Return the commanded current [A] at the uniform times, shape (n,)."""


def duration() -> Any:
    """Declare the duration of a part."""
    return quantity(REQUIRED, "s", "duration of the part", 0.05, 7200.0)


def find_spans(parts: Parts[T], time_s: F) -> Iterator[tuple[T, slice]]:
    """Yield each part, again and again, with the samples of `time_s` (n,) that belong to it."""
    start, end, index = 0, 0.0, 0
    while start < len(time_s):
        duration, part = parts[index % len(parts)]
        end += duration
        stop = int(np.searchsorted(time_s, time_s[0] + end - 1e-9))
        if stop > start:
            yield part, slice(start, stop)
        start, index = max(stop, start), index + 1


COLUMNS = ("time_s", "position_m")
MAX_ROWS = 10_000_000
MIN_ROWS = 4


@dataclass(frozen=True)
class StrokeFile:
    """The cubic spline through the file's samples; before the first and after the last sample it rests there.

    `table` raises CesError for a file that is no stroke.
    """

    path: str = part(meaning="CSV file")

    @cached_property
    def table(self) -> tuple[F, F]:
        """Times [s] and positions [m], each (n,)."""
        return read_stroke_file(Path(self.path))

    def samples(self, time_s: F, rng: Generator) -> F:
        """Return the position [m] at the times (n,)."""
        return SampledStroke(*self.table).samples(time_s, rng)


@dataclass(frozen=True)
class SampledStroke:
    """A stroke held in memory: times [s], rising, and positions [m], each (n,)."""

    times_s: F
    positions_m: F

    def samples(self, time_s: F, rng: Generator) -> F:
        """Return the cubic spline through the samples at the times (n,), at rest outside them."""
        inside = np.clip(time_s, self.times_s[0], self.times_s[-1])
        return np.asarray(CubicSpline(self.times_s, self.positions_m)(inside))


def read_stroke_file(path: Path) -> tuple[F, F]:
    """Return times [s] and positions [m] of a stroke file; raises CesError naming the line."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            lines = csv.DictReader(file)
            lines.fieldnames = head = [name.strip() for name in lines.fieldnames or ()]
            if any(name not in head for name in COLUMNS):
                raise CesError(f"{path}: columns are {', '.join(head)[:200] or 'none'}; expected {', '.join(COLUMNS)}")
            rows = np.array([_numbers(line, f"{path}:{lines.line_num}") for line in islice(lines, MAX_ROWS + 1)])
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise CesError(f"{path}: cannot be read as CSV: {error}; expected the columns {', '.join(COLUMNS)}") from None
    if not MIN_ROWS <= len(rows) <= MAX_ROWS:
        raise CesError(f"{path}: {len(rows)} samples; expected at least {MIN_ROWS} and at most {MAX_ROWS}")
    late = np.flatnonzero(np.diff(rows[:, 0]) <= 0.0)
    if len(late):
        raise CesError(f"{path}:{late[0] + 3}: time_s does not rise; expected increasing times")
    return rows[:, 0], rows[:, 1]


def _numbers(line: Mapping[str, str], where: str) -> tuple[float, float]:
    try:
        time, position = (float(line[name]) for name in COLUMNS)
        if isfinite(time) and isfinite(position):
            return time, position
    except (ValueError, TypeError):
        pass
    found = ",".join(str(line[name]) for name in COLUMNS)
    raise CesError(f"{where}: {found[:60]!r}; expected finite numbers in {', '.join(COLUMNS)}")


def filtered_noise(count: int, rate_Hz: float, order: int, cutoff_Hz: float, lead_s: float, rng: Generator) -> F:
    """Return white noise (count,) behind a Butterworth low-pass that began `lead_s` earlier."""
    lead = round(lead_s * rate_Hz)
    low_pass = butter(order, cutoff_Hz, fs=rate_Hz, output="sos")
    return np.asarray(sosfilt(low_pass, rng.standard_normal(lead + count))[lead:])
