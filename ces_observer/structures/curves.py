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
from ces_observer.limits import FileLimits, NumberLimits
from ces_observer.records import bounded
from ces_observer.structures.structure import require_length
from ces_observer.tick.curves import MIN_RISE


def nodes(
    key: str, min_count: int = 2, max_count: int = FileLimits.MAX_ITEMS, low: float = -NumberLimits.MAX_NUMBER
) -> Any:
    """Declare the coordinates of a curve's nodes, or rows of them."""
    return bounded(low, NumberLimits.MAX_NUMBER, key=key, min_count=min_count, max_count=max_count)


@dataclass(frozen=True)
class IncreasingCurve:
    """A valve's setting, from 0 to 1, over the current [A]: a curve through nodes; both rise strictly."""

    at: tuple[float, ...] = nodes("current_A")
    values: tuple[float, ...] = nodes("setting")

    def checked(self) -> Self:
        """Return it; raises ModelError unless it rises from 0 to 1."""
        require_rising("current_A", self.at)
        require_rising("setting", self.values, len(self.at))
        check_slopes(self.at, self.values)
        if self.values[0] != 0.0 or self.values[-1] != 1.0:
            raise ModelError(f"setting runs from {self.values[0]:g} to {self.values[-1]:g}; expected 0 to 1")
        return self


def interpolate(at: Sequence[float], values: Sequence[float], x: float) -> float:
    """Return the value at `x` of the piecewise-linear curve through the nodes."""
    j = min(max(bisect_right(at, x), 1), len(at) - 1) - 1
    return values[j] + (values[j + 1] - values[j]) * ((x - at[j]) / (at[j + 1] - at[j]))


def require_rising(name: str, values: Sequence[float], count: int | None = None) -> None:
    """Raise ModelError unless `count` numbers rise by more than rounding errors."""
    if count is not None:
        require_length(name, values, count)
    least = MIN_RISE * max(map(abs, values))
    if not all(b - a > least for a, b in pairwise(values)):
        raise ModelError(f"{name} does not rise from number to number; identify the model again")


def check_slopes(at: Sequence[float], values: Sequence[float], least: float = NumberLimits.SLOPES[0]) -> None:
    """Raise ModelError if a curve is too steep, or flatter than `least`, for a step that loses no digits."""
    for (x, y), (x1, y1) in pairwise(zip(at, values, strict=True)):
        slope = (y1 - y) / (x1 - x)
        if not least <= abs(slope) <= NumberLimits.SLOPES[1]:
            expected = f"expected {least:g} to {NumberLimits.SLOPES[1]:g}: identify the model again"
            raise ModelError(f"a slope of {slope:g} from {x:g} on; {expected}")


def check_over_stroke(name: str, position_m: Sequence[float], values: Sequence[float]) -> None:
    """Raise ModelError unless `values`, which may fall, are a curve over the stroke."""
    require_rising("position_m", position_m)
    require_length(name, values, len(position_m))
    check_slopes(position_m, values, 0.0)


@dataclass(frozen=True)
class FlowMap:
    """Forces [N] over `at` [m/s]: `rows[k]` at the setting k / (rows - 1), each rising strictly; one for all."""

    at: tuple[float, ...] = nodes("flow_m_s")
    rows: tuple[tuple[float, ...], ...] = nodes("force_N", 1, FileLimits.MAX_CURVES)

    def checked(self) -> Self:
        """Return it; raises ModelError unless each curve rises through the origin."""
        require_rising("flow_m_s", self.at)
        for row in self.rows:
            require_rising("force_N", row, len(self.at))
            check_slopes(self.at, row)
        if 0.0 not in self.at or any(row[self.at.index(0.0)] != 0.0 for row in self.rows):
            raise ModelError("no node at flow_m_s 0 with force_N 0 in every list; identify the model again")
        return self


@dataclass(frozen=True)
class Bypass:
    """A bypass over the stroke [m]: flow [m/s] over the root of the drop [N], geometric between nodes."""

    position_m: tuple[float, ...] = nodes("position_m")
    values: tuple[float, ...] = nodes("opening", low=NumberLimits.MIN_OPENING)

    def checked(self) -> Self:
        """Return it; raises ModelError if it is no curve over the stroke."""
        check_over_stroke("opening", self.position_m, self.values)
        return self

    @cached_property
    def logarithms(self) -> tuple[float, ...]:
        """The logarithms of the openings."""
        return tuple(map(log, self.values))
