"""Bounds on the energy of a damper's two chambers, for every input and every setting of the valve.

A step adds at most T (drive a' P - P' L(P)) to the energy 1/2 P' S P, with P the pressures after it (see `chambers`).
So the energy grows only into the set P' L(P) <= fastest |a' P|, and no run from rest exceeds its largest energy there.
"""

from __future__ import annotations

from collections.abc import Callable
from heapq import heapify, heappop, heappush
from math import cos, inf, pi, sin
from typing import TYPE_CHECKING

from ces_observer.structures.increasing_curves import IncreasingCurve
from ces_observer.structures.structure import Range

if TYPE_CHECKING:
    from ces_observer.structures.chambers import Chambers

MAX_PRESSURE_N = 1e12
COARSE, FINE = 64, 8192  # intervals of directions (p_c, p_r) in a turn: at the start, and where the bound is found
MAX_HALVINGS = 1000
ROUNDING = 1e-9  # relative, far above what the bound's arithmetic loses


def bound_energy(model: Chambers, fastest: float) -> float:
    """Return a bound on 1/2 P' S P over all P with P' L(P) <= fastest |a' P|: no run from rest has more energy.

    Along a ray P = t d, d' L(t d) rises with t, so the set ends at one t. For each interval of directions that t is
    bounded with the least dissipation and the largest drive of the interval, over all settings of the valve; the
    interval with the most energy is halved until it is narrow (best first), so that the bound is tight.
    """
    flows = _Flows(model)
    queue = [(-flows.bound_energy(k, COARSE, fastest), k, COARSE) for k in range(COARSE)]
    heapify(queue)
    for _ in range(MAX_HALVINGS):
        if queue[0][2] >= FINE:
            break
        _, k, count = heappop(queue)
        for half in (2 * k, 2 * k + 1):
            heappush(queue, (-flows.bound_energy(half, 2 * count, fastest), half, 2 * count))
    return -queue[0][0] * (1.0 + ROUNDING)


class _Flows:
    """Bounds over intervals of directions d: the k-th of `count`, and for every setting of the valve."""

    def __init__(self, model: Chambers) -> None:
        self._model = model
        self._ratio = 1.0 + model.area_ratio
        self._check, self._refill = model.check, model.refill
        self._valves = model.map.inverses

    def bound_energy(self, k: int, count: int, fastest: float) -> float:
        """Return a bound on the energy of all P of the interval with P' L(P) <= fastest |a' P|."""
        model, d_c, d_r = self._model, _range(cos, k, count), _range(sin, k, count)
        force = self._largest_force(d_c, d_r)
        end = self._reach(d_c, d_r, fastest * force)
        c, r = max(map(abs, d_c)), max(map(abs, d_r))
        stored = model.compression_m_N * c * c + model.rebound_m_N * r * r + model.mount_m_N * force * force
        return 0.5 * stored * end * end

    def _largest_force(self, d_c: Range, d_r: Range) -> float:
        """Return the largest |a' d| of the directions."""
        ends = self._ratio * d_c[0] - d_r[1], self._ratio * d_c[1] - d_r[0]
        return max(map(abs, ends)) * (1.0 + ROUNDING)

    def _reach(self, d_c: Range, d_r: Range, driven: float) -> float:
        """Return a length t [N] from which on every direction dissipates more than `driven`; infinite if none."""
        high = 1.0
        while self._dissipated(d_c, d_r, high) <= driven:
            high *= 2.0
            if high > MAX_PRESSURE_N:
                return inf
        low = 0.0 if high == 1.0 else 0.5 * high
        while high - low > 1e-4 * high:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self._dissipated(d_c, d_r, middle) > driven else (middle, high)
        return high

    def _dissipated(self, d_c: Range, d_r: Range, t: float) -> float:
        total = _least(self._check, (d_c[0] - d_r[1], d_c[1] - d_r[0]), t)
        total += _least(self._refill, (-d_c[1], -d_c[0]), t)
        return total + min(_least(valve, d_r, t) for valve in self._valves)


def _range(function: Callable[[float], float], k: int, count: int) -> Range:
    """Return the range of cos or sin over the k-th of `count` angles of a turn, none of which crosses a quarter."""
    ends = [function(2.0 * pi * n / count) for n in (k, k + 1)]
    return min(ends) - 1e-12, max(ends) + 1e-12


def _least(curve: IncreasingCurve, d: Range, t: float) -> float:
    """Return the least d curve(t d) over the interval; a curve through the origin has its least nearest to it."""
    if d[0] < 0.0 < d[1]:
        return 0.0
    return min(end * curve(t * end) for end in d)
