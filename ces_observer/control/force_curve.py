"""The desired speed-force curve: breakpoints in, a force for every speed out."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite

from ces_observer.errors import CesError

MAX_POINTS = 1000


class CurveError(CesError):
    """A desired speed-force curve that cannot be used."""


@dataclass(frozen=True)
class ForceCurve:
    """Piecewise linear force [N] over speed [m/s], both positive in compression; constant beyond its ends.

    A semi-active damper can only dissipate, so the force is at least 0 in compression and at most 0 in rebound. Raises
    CurveError for points that are not finite, not in order, or that would drive the motion.
    """

    speeds_m_s: tuple[float, ...]
    forces_N: tuple[float, ...]

    def __post_init__(self) -> None:
        self._check_numbers()
        for speed, force in zip(self.speeds_m_s, self.forces_N, strict=True):
            if speed * force < 0.0:
                raise CurveError(
                    f"curve: {force:g} N at {speed:g} m/s would drive the motion; expected a force of the speed's sign"
                )
        at_rest = self.at(0.0)
        if self.speeds_m_s[0] < 0.0 < self.speeds_m_s[-1] and at_rest != 0.0:
            raise CurveError(f"curve: {at_rest:g} N at rest; expected 0: add a point at speed 0, force 0")

    @classmethod
    def from_points(cls, speeds_m_s: Sequence[float], forces_N: Sequence[float]) -> ForceCurve:
        """Return the curve through these points; raises CurveError."""
        return cls(tuple(map(float, speeds_m_s)), tuple(map(float, forces_N)))

    def at(self, speed_m_s: float) -> float:
        """Return the desired force [N] at a finite speed [m/s]."""
        speeds, forces = self.speeds_m_s, self.forces_N
        right = bisect_right(speeds, speed_m_s)
        if right == 0:
            return forces[0]
        if right == len(speeds):
            return forces[-1]
        share = (speed_m_s - speeds[right - 1]) / (speeds[right] - speeds[right - 1])
        return forces[right - 1] + share * (forces[right] - forces[right - 1])

    def _check_numbers(self) -> None:
        speeds, forces = self.speeds_m_s, self.forces_N
        if len(speeds) != len(forces) or not 2 <= len(speeds) <= MAX_POINTS:
            raise CurveError(
                f"curve: {len(speeds)} speeds and {len(forces)} forces; expected as many of each, 2 to {MAX_POINTS}"
            )
        if not all(map(isfinite, (*speeds, *forces))):
            raise CurveError("curve: a speed or force is not finite; give finite numbers in m/s and N")
        if any(right <= left for left, right in pairwise(speeds)):
            raise CurveError("curve: the speeds are not in rising order; sort the points by speed, each speed once")
