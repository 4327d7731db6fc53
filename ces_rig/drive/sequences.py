"""Strokes and currents made of parts that follow one another, such as the test points of a dyno.

Each part has a duration and times of its own; after the last part the sequence begins again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from ces_rig.descriptions import REQUIRED, build, quantity
from ces_rig.errors import RigError

Array = NDArray[np.float64]
T = TypeVar("T")
Parts = Sequence[tuple[float, T]]  # duration [s] and shape of each part

KIND = "sequence"
MAX_PARTS = 1000


class StrokePart(Protocol):
    """A stroke, with its own offset and fade."""

    def samples(self, time_s: Array, rng: Generator) -> Array:
        """Return the position [m] at the uniform times (n,)."""


class CurrentPart(Protocol):
    """A current that is known before the damper moves."""

    def samples(self, time_s: Array, stroke_m: Array, rng: Generator) -> Array:
        """Return the commanded current [A] at the uniform times (n,)."""


@dataclass(frozen=True)
class Lasting:
    """How long a part lasts."""

    duration_s: float = quantity(REQUIRED, "s", "duration of the part", 0.05, 7200.0)


@dataclass(frozen=True)
class StrokeSequence:
    """Strokes one after the other; each fades in and out by itself."""

    parts: Parts[StrokePart]

    def samples(self, time_s: Array, rng: Generator) -> Array:
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

    def samples(self, time_s: Array, stroke_m: Array, rng: Generator) -> Array:
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
    lasting = build(Lasting, {key: part[key] for key in ("duration_s",) if key in part}, where)
    return lasting.duration_s, make({key: value for key, value in part.items() if key != "duration_s"}, where)


def _find_spans(parts: Parts[T], time_s: Array) -> Iterator[tuple[T, slice]]:
    """Yield each part, again and again, with the samples of `time_s` (n,) that belong to it."""
    start, end, index = 0, 0.0, 0
    while start < len(time_s):
        duration, part = parts[index % len(parts)]
        end += duration
        stop = int(np.searchsorted(time_s, time_s[0] + end - 1e-9))
        if stop > start:
            yield part, slice(start, stop)
        start, index = max(stop, start), index + 1
