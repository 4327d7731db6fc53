"""Strokes and currents made of parts that follow one another, such as the test points of a dyno.

Each part has a duration and times of its own; after the last part the sequence begins again.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.random import Generator
from scipy.interpolate import CubicSpline

from ces_data.arrays import F
from ces_observer.fields import REQUIRED, quantity, read_record, setting
from ces_rig.errors import RigError

T = TypeVar("T")
Parts = Sequence[tuple[float, T]]  # duration [s] and shape of each part

KIND = "sequence"
MAX_PARTS = 1000


class StrokePart(Protocol):
    """A stroke, with its own offset and fade."""

    def samples(self, time_s: F, rng: Generator) -> F:
        """Return the position [m] at the uniform times (n,)."""


class CurrentPart(Protocol):
    """A current that is known before the damper moves."""

    def samples(self, time_s: F, stroke_m: F, rng: Generator) -> F:
        """Return the commanded current [A] at the uniform times (n,)."""


@dataclass(frozen=True)
class TimedPart:
    """How long a part lasts."""

    duration_s: float = quantity(REQUIRED, "s", "duration of the part", 0.05, 7200.0)


@dataclass(frozen=True)
class StrokeSequence:
    """Strokes one after the other; each fades in and out by itself."""

    parts: Parts[StrokePart]

    def samples(self, time_s: F, rng: Generator) -> F:
        """Return the position [m] at the uniform times (n,)."""
        position = np.zeros_like(time_s)
        for part, span in _find_spans(self.parts, time_s):
            if span.stop - span.start > 1:
                position[span] = part.samples(time_s[span] - time_s[span.start], rng)
        return position


@dataclass(frozen=True)
class CurrentSequence:
    """Currents one after the other."""

    parts: Parts[CurrentPart]

    def samples(self, time_s: F, stroke_m: F, rng: Generator) -> F:
        """Return the commanded current [A] at the uniform times (n,)."""
        current = np.empty_like(time_s)
        for part, span in _find_spans(self.parts, time_s):
            current[span] = part.samples(time_s[span] - time_s[span.start], stroke_m[span], rng)
        return current


def parse_parts(
    settings: Mapping[str, Any], where: str, make: Callable[[object, str], T]
) -> tuple[tuple[float, T], ...]:
    """Return the parts of `{parts: [{duration_s: ..., what `make` reads}, ...]}`; raises RigError."""
    parts = settings.get("parts")
    if set(settings) != {"parts"} or not isinstance(parts, list) or not 0 < len(parts) <= MAX_PARTS:
        raise RigError(f"{where}: a sequence has the key 'parts' only; expected a list of 1 to {MAX_PARTS} parts")
    return tuple(_parse_part(part, f"{where}: part {number}", make) for number, part in enumerate(parts, 1))


def _parse_part(part: object, where: str, make: Callable[[object, str], T]) -> tuple[float, T]:
    if not isinstance(part, Mapping) or part.get("kind") == KIND:
        raise RigError(f"{where} is {part!r}; expected a mapping with kind and duration_s, and no sequence in it")
    lasting = read_record(TimedPart, {key: part[key] for key in ("duration_s",) if key in part}, where, RigError)
    return lasting.duration_s, make({key: value for key, value in part.items() if key != "duration_s"}, where)


def _find_spans(parts: Parts[T], time_s: F) -> Iterator[tuple[T, slice]]:
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

    `table` raises RigError for a file that is no stroke.
    """

    path: str = setting(REQUIRED, "CSV file")

    @cached_property
    def table(self) -> tuple[F, F]:
        """Times [s] and positions [m], each (n,)."""
        return read_stroke_file(Path(self.path))

    def samples(self, time_s: F, rng: Generator) -> F:
        """Return the position [m] at the times (n,)."""
        return interpolate_stroke(*self.table, time_s)


@dataclass(frozen=True)
class SampledStroke:
    """A stroke held in memory: times [s], rising, and positions [m], each (n,)."""

    times_s: F
    positions_m: F

    def samples(self, time_s: F, rng: Generator) -> F:
        """Return the position [m] at the times (n,)."""
        return interpolate_stroke(self.times_s, self.positions_m, time_s)


def interpolate_stroke(times_s: F, positions_m: F, at_s: F) -> F:
    """Return the cubic spline through the samples at `at_s` (n,), at rest outside them."""
    return np.asarray(CubicSpline(times_s, positions_m)(np.clip(at_s, times_s[0], times_s[-1])))


def read_stroke_file(path: Path) -> tuple[F, F]:
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
