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
MIN_RISE = 1e-12  # between nodes, relative to the largest: less is lost in the rounding of a blend of two curves
MIN_SLOPE, MAX_SLOPE = 1e-15, 1e12  # far beyond those of any damper's curve, in any of its units

Piece = tuple[float, float, float]  # a straight piece: its left node (x, y), and its slope


def pieces(at: Sequence[float], values: Sequence[float]) -> tuple[Piece, ...]:
    """Return the pieces between nodes (at, values); `bisect_left(at[1:-1], x)` is the index of the one that holds x."""
    ends = zip(pairwise(at), pairwise(values), strict=True)
    return tuple((x0, y0, (y1 - y0) / (x1 - x0)) for (x0, x1), (y0, y1) in ends)


def place_inside(ends: Sequence[float], n: int) -> float:
    """Return a place in the n-th of the pieces that meet at `ends`, which rise; the outer pieces have no other end."""
    if not ends:
        return 0.0
    if 0 < n < len(ends):
        return 0.5 * (ends[n - 1] + ends[n])
    return ends[0] - 1.0 - abs(ends[0]) if n == 0 else ends[-1] + 1.0 + abs(ends[-1])


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

    def to_json(self, at: str, values: str) -> dict[str, Any]:
        """Return the nodes under these keys."""
        return {at: list(self.at), values: list(self.values)}


def interpolate(at: Sequence[float], values: Sequence[float], x: float) -> float:
    """Return the value at `x` of the piecewise-linear curve through the nodes."""
    j = min(max(bisect_right(at, x), 1), len(at) - 1) - 1
    return values[j] + (values[j + 1] - values[j]) * ((x - at[j]) / (at[j + 1] - at[j]))


def parse_nodes(node: JsonObject, key: str, count: int | None = None, rising: bool = True) -> tuple[float, ...]:
    """Check a list of numbers in a model file, rising by more than rounding errors if `rising`; raises ModelError."""
    value = node.value.get(key)
    found = len(value) if isinstance(value, list) else 0
    numbers = node.numbers(key, min(max(found, 2), MAX_NODES) if count is None else count, MAX_VALUE)
    least = MIN_RISE * max(map(abs, numbers))
    if rising and not all(b - a > least for a, b in pairwise(numbers)):
        raise ModelError(f"{node.where}: {key} does not rise from number to number; identify the model again")
    return numbers


def check_slopes(where: str, at: Sequence[float], values: Sequence[float], rising: bool = True) -> None:
    """Raise ModelError if a curve is too steep or, if `rising`, too flat for a step that loses no digits."""
    least = MIN_SLOPE if rising else 0.0
    for x, _, slope in pieces(at, values):
        if not least <= abs(slope) <= MAX_SLOPE:
            raise ModelError(
                f"{where}: a slope of {slope:g} from {x:g} on; expected {least:g} to {MAX_SLOPE:g}: identify the model "
                "again"
            )


def parse_curve(node: JsonObject, at: str, values: str) -> IncreasingCurve:
    """Check the nodes of a curve in a model file; raises ModelError."""
    node.require_only_keys(at, values)
    places = parse_nodes(node, at)
    curve = IncreasingCurve(places, parse_nodes(node, values, len(places)))
    check_slopes(node.where, curve.at, curve.values)
    return curve
