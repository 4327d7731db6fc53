"""The inverse map: a damper's steady force on a grid, inverted; speed and desired force in, current out.

`ces_observer.control.steady_force` computes it from a model. The inverse is unique, because the force is monotone over
current, and saturates at the grid's ends.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import copysign, isfinite

from ces_observer.errors import CesError


@dataclass(frozen=True)
class InverseMap:
    """Steady force [N] on a grid: `forces_N[n]` is over `currents_A` at `speeds_m_s[n]`, monotone.

    More current means more damping everywhere, or less everywhere. Speeds rise and do not include zero; below the
    smallest the force is proportional to speed, beyond the largest it is constant. Raises CesError for a grid of
    another shape or numbers that are not finite.
    """

    speeds_m_s: tuple[float, ...]
    currents_A: tuple[float, ...]
    forces_N: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        shapes = {len(row) for row in self.forces_N}
        numbers = (*self.speeds_m_s, *self.currents_A, *(force for row in self.forces_N for force in row))
        if len(self.forces_N) != len(self.speeds_m_s) or shapes != {len(self.currents_A)} or len(self.currents_A) < 2:
            raise CesError("inverse map: expected a row of forces for each speed, one force for each current")
        if not all(map(isfinite, numbers)) or not (_is_rising(self.speeds_m_s) and _is_rising(self.currents_A)):
            raise CesError("inverse map: expected finite forces on rising speeds and currents")
        if not self.speeds_m_s[0] < 0.0 < self.speeds_m_s[-1] or 0.0 in self.speeds_m_s:
            raise CesError("inverse map: expected speeds on both sides of zero, without zero")

    @cached_property
    def sense(self) -> float:
        """1 if more current means more damping, -1 if less."""
        signed = zip(self.speeds_m_s, self.forces_N, strict=True)
        return copysign(1.0, sum(copysign(1.0, speed) * (row[-1] - row[0]) for speed, row in signed))

    def row(self, speed_m_s: float) -> list[float]:
        """Return the forces [N] over `currents_A` at this speed."""
        speeds, forces = self.speeds_m_s, self.forces_N
        right = bisect_right(speeds, speed_m_s)
        if right == 0:
            return list(forces[0])
        if right == len(speeds):
            return list(forces[-1])
        left_speed, right_speed = speeds[right - 1], speeds[right]
        if left_speed < 0.0 < right_speed:  # rebound and compression are independent
            nearest, speed = (forces[right], right_speed) if speed_m_s >= 0.0 else (forces[right - 1], left_speed)
            return [speed_m_s / speed * force for force in nearest]
        share = (speed_m_s - left_speed) / (right_speed - left_speed)
        return [a + share * (b - a) for a, b in zip(forces[right - 1], forces[right], strict=True)]

    def force(self, speed_m_s: float, current_A: float) -> float:
        """Return the steady force [N]; a current beyond the grid is clipped to it."""
        return _interpolate(self.currents_A, self.row(speed_m_s), current_A)

    def current(self, speed_m_s: float, force_N: float) -> float:
        """Return the current [A] of this force or the nearest possible one; of several the lowest."""
        currents, sense = self.currents_A, self.sense if speed_m_s >= 0.0 else -self.sense
        rising = [sense * force for force in self.row(speed_m_s)]
        target = min(sense * force_N, rising[-1])
        right = bisect_left(rising, target)
        if right == 0:
            return currents[0]
        share = (target - rising[right - 1]) / (rising[right] - rising[right - 1])
        return currents[right - 1] + share * (currents[right] - currents[right - 1])

    def slope(self, speed_m_s: float, current_A: float) -> float:
        """Return dF/di [N/A]: the secant over up to three cells of the grid, because one cell may be flat."""
        row, currents = self.row(speed_m_s), self.currents_A
        right = min(max(bisect_right(currents, current_A), 1), len(currents) - 1)
        low, high = max(right - 2, 0), min(right + 1, len(currents) - 1)
        return (row[high] - row[low]) / (currents[high] - currents[low])


def _interpolate(points: Sequence[float], values: Sequence[float], at: float) -> float:
    right = min(max(bisect_right(points, at), 1), len(points) - 1)
    share = min(max((at - points[right - 1]) / (points[right] - points[right - 1]), 0.0), 1.0)
    return values[right - 1] + share * (values[right] - values[right - 1])


def _is_rising(values: Sequence[float]) -> bool:
    return all(b > a for a, b in pairwise(values))
