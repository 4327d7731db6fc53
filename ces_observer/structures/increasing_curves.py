"""Piecewise-linear curves that never fall: nodes in, values, slopes and inverses out; straight beyond both ends."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from ces_observer.errors import ModelError
from ces_observer.json_checks import JsonObject

MAX_NODES = 64
MAX_VALUE = 1e9

Segment = tuple[float, float]  # intercept and slope of a straight piece


def segments(at: Sequence[float], values: Sequence[float]) -> tuple[Segment, ...]:
    """Return intercept and slope of each piece between nodes (at, values)."""
    pieces = zip(pairwise(at), pairwise(values), strict=True)
    slopes = ((x0, y0, (y1 - y0) / (x1 - x0)) for (x0, x1), (y0, y1) in pieces)
    return tuple((y0 - slope * x0, slope) for x0, y0, slope in slopes)


@dataclass(frozen=True)
class IncreasingCurve:
    """A curve through the nodes (at[j], values[j]); both rise strictly."""

    at: tuple[float, ...]
    values: tuple[float, ...]

    def __call__(self, x: float) -> float:
        """Return the value at `x`; beyond the ends the last pieces go on straight."""
        return interpolate(self.at, self.values, x)

    def inverse(self, y: float) -> float:
        """Return where the curve has the value `y`."""
        return interpolate(self.values, self.at, y)

    @property
    def min_slope(self) -> float:
        """The smallest slope anywhere."""
        return min(slope for _, slope in segments(self.at, self.values))

    def to_json(self, at: str, values: str) -> dict[str, Any]:
        """Return the nodes under these keys."""
        return {at: list(self.at), values: list(self.values)}


def interpolate(at: Sequence[float], values: Sequence[float], x: float) -> float:
    """Return the value at `x` of the piecewise-linear curve through the nodes."""
    j = min(max(bisect_right(at, x), 1), len(at) - 1) - 1
    return values[j] + (values[j + 1] - values[j]) * ((x - at[j]) / (at[j + 1] - at[j]))


def parse_nodes(node: JsonObject, key: str, count: int | None = None, rising: bool = True) -> tuple[float, ...]:
    """Check a list of numbers in a model file, rising strictly if `rising`; raises ModelError."""
    value = node.value.get(key)
    found = len(value) if isinstance(value, list) else 0
    numbers = node.numbers(key, min(max(found, 2), MAX_NODES) if count is None else count, MAX_VALUE)
    if rising and not all(b > a for a, b in pairwise(numbers)):
        raise ModelError(f"{node.where}: {key} does not rise from number to number; identify the model again")
    return numbers


def parse_curve(node: JsonObject, at: str, values: str) -> IncreasingCurve:
    """Check the nodes of a curve in a model file; raises ModelError."""
    node.require_only_keys(at, values)
    places = parse_nodes(node, at)
    return IncreasingCurve(places, parse_nodes(node, values, len(places)))
