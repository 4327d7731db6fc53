"""Piecewise-linear curves that never fall: nodes in, values, slopes and inverses out; straight beyond both ends.

A valve's map is one such curve for each of a few settings, blended linearly between neighbours. The curves share their
abscissa (a speed or a flow [m/s]) and give a force [N]; settings are spaced evenly from 0 to 1.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import log
from typing import Any, Self

from ces_observer.errors import ModelError
from ces_observer.json_text import JsonObject
from ces_observer.tick.curves import MIN_RISE

MAX_NODES = 64
MAX_VALUE = 1e9
MIN_OPENING = 1e-12  # of a bypass
MIN_SLOPE, MAX_SLOPE = 1e-15, 1e12  # far beyond those of any damper's curve, in any of its units


@dataclass(frozen=True)
class IncreasingCurve:
    """A curve through the nodes (at[j], values[j]); both rise strictly."""

    at: tuple[float, ...]
    values: tuple[float, ...]

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
    for (x, y), (x1, y1) in pairwise(zip(at, values, strict=True)):
        slope = (y1 - y) / (x1 - x)
        if not least <= abs(slope) <= MAX_SLOPE:
            raise ModelError(
                f"{where}: a slope of {slope:g} from {x:g} on; expected {least:g} to {MAX_SLOPE:g}: identify the model "
                "again"
            )


MAX_CURVES = 16


@dataclass(frozen=True)
class FlowMap:
    """Forces [N] over `at` [m/s]: `rows[k]` at the setting k / (rows - 1), each rising strictly; one for all."""

    at: tuple[float, ...]
    rows: tuple[tuple[float, ...], ...]

    def to_json(self, at: str) -> dict[str, Any]:
        """Return the contents of the model file; `at` names the abscissa."""
        return {at: list(self.at), "force_N": [list(row) for row in self.rows]}

    @classmethod
    def from_json(cls, node: JsonObject, at: str) -> Self:
        """Check it in a model file; raises ModelError."""
        node.require_only_keys(at, "force_N")
        places = parse_nodes(node, at)
        rows = node.value.get("force_N")
        if not isinstance(rows, list) or not 1 <= len(rows) <= MAX_CURVES:
            raise ModelError(f"{node.where}: force_N has no 1 to {MAX_CURVES} lists; expected one for each setting")
        parsed = [parse_nodes(JsonObject({"force_N": row}, node.where), "force_N", len(places)) for row in rows]
        for row in parsed:
            check_slopes(node.where, places, row)
        return cls(places, tuple(parsed))


@dataclass(frozen=True)
class Bypass:
    """A bypass over the stroke [m]: flow [m/s] over the root of the drop [N], geometric between nodes."""

    position_m: tuple[float, ...]
    values: tuple[float, ...]

    @cached_property
    def logarithms(self) -> tuple[float, ...]:
        """The logarithms of the openings."""
        return tuple(map(log, self.values))


def parse_bypass(node: JsonObject) -> Bypass | None:
    """Check the bypass of a model file, empty if there is none; raises ModelError."""
    if not node.value:
        return None
    node.require_only_keys("position_m", "opening")
    positions = parse_nodes(node, "position_m")
    opening = parse_nodes(node, "opening", len(positions), rising=False)
    check_slopes(node.where, positions, opening, rising=False)
    if min(opening) < MIN_OPENING:
        raise ModelError(f"{node.where}: opening has {min(opening):g}; expected numbers from {MIN_OPENING:g} on")
    return Bypass(positions, opening)
