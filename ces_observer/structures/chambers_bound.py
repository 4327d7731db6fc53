"""Bounds on the energy of a damper's two chambers, for every input and every setting of the valve.

A step adds at most T (drive a' P - P' L(P)) to the energy 1/2 P' S P, with P the pressures after it (see `chambers`).
So the energy grows only into the set P' L(P) <= fastest |a' P|, and no run from rest exceeds its largest energy there.
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, inf, pi, sin
from typing import TYPE_CHECKING

from ces_observer.structures.increasing_curves import IncreasingCurve
from ces_observer.structures.structure import Range

if TYPE_CHECKING:
    from ces_observer.structures.chambers import Chambers

MAX_PRESSURE_N = 1e12
DIRECTIONS = 360  # of (p_c, p_r), each an interval of angles, over which the energy is bounded
ROUNDING = 1e-9  # relative, far above what the bound's arithmetic loses


def bound_energy(model: Chambers, fastest: float) -> float:
    """Return a bound on 1/2 P' S P over all P with P' L(P) <= fastest |a' P|: no run from rest has more energy.

    Along a ray P = t d, d' L(t d) rises with t, so the set ends at one t. For each interval of directions that t is
    bounded with the least dissipation and the largest drive of the interval, over all settings of the valve.
    """
    flows = _Flows(model)
    most = 0.0
    for k in range(DIRECTIONS):
        d_c, d_r = _range(cos, k), _range(sin, k)
        force = flows.largest_force(d_c, d_r)
        end = flows.reach(d_c, d_r, fastest * force)
        c, r = max(map(abs, d_c)), max(map(abs, d_r))
        stored = model.compression_m_N * c * c + model.rebound_m_N * r * r + model.mount_m_N * force * force
        most = max(most, 0.5 * stored * end * end)
    return most * (1.0 + ROUNDING)


class _Flows:
    """The least dissipation d' L(t d) [m/s] over an interval of directions d, for every setting of the valve."""

    def __init__(self, model: Chambers) -> None:
        self._ratio = 1.0 + model.area_ratio
        self._check, self._refill = model.check, model.refill
        self._valves = [IncreasingCurve(curve.values, curve.at) for curve in (model.map.highest, model.map.lowest)]

    def largest_force(self, d_c: Range, d_r: Range) -> float:
        """Return the largest |a' d| of the directions."""
        ends = self._ratio * d_c[0] - d_r[1], self._ratio * d_c[1] - d_r[0]
        return max(map(abs, ends)) * (1.0 + ROUNDING)

    def reach(self, d_c: Range, d_r: Range, driven: float) -> float:
        """Return a length t [N] from which on every direction dissipates more than `driven`; infinite if none."""
        high = 1.0
        while self._dissipated(d_c, d_r, high) <= driven:
            high *= 2.0
            if high > MAX_PRESSURE_N:
                return inf
        low = 0.0 if high == 1.0 else 0.5 * high
        while high - low > 1e-3 * high:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self._dissipated(d_c, d_r, middle) > driven else (middle, high)
        return high

    def _dissipated(self, d_c: Range, d_r: Range, t: float) -> float:
        total = _least(self._check, (d_c[0] - d_r[1], d_c[1] - d_r[0]), t)
        total += _least(self._refill, (-d_c[1], -d_c[0]), t)
        return total + min(_least(valve, d_r, t) for valve in self._valves)


def _range(function: Callable[[float], float], k: int) -> Range:
    """Return the range of cos or sin over the k-th interval of angles, none of which crosses a quarter turn."""
    ends = [function(2.0 * pi * n / DIRECTIONS) for n in (k, k + 1)]
    return min(ends) - 1e-12, max(ends) + 1e-12


def _least(curve: IncreasingCurve, d: Range, t: float) -> float:
    """Return the least d curve(t d) over the interval; a curve through the origin has its least nearest to it."""
    if d[0] < 0.0 < d[1]:
        return 0.0
    return min(end * curve(t * end) for end in d)
