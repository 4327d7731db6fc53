"""The free run of a model with two chambers: one force for each tick, from the exact solution of its step.

With a = (r, -1), r = 1 + ratio, a step solves (S / T) (P - P(k-1)) = a drive - L(P). On given pieces of the curves the
flows L are straight lines with slopes `across` (check valve), `sucked` (refill) and `through` (valve). The change of P
follows from their values at P(k-1), here with all sums arranged so that none cancels:

    det   = (C_c + sucked) (C_r + M + across + through) + (r^2 M + across) (C_r + through) + M across ratio^2
    x, y  = M (ratio check + refill - r valve),  across (ratio drive + refill - valve)
    det dp_c = (C_r + through) (r drive - check + refill) + x + y
    det dp_r = (C_c + sucked) (check - drive - valve) + r x + y

with C_c, C_r and M divided by T. A step starts on the pieces of the last one and follows the solutions from piece to
piece (Newton's method), which mostly ends at once; if not, it searches p_r in a bracket that halves.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from itertools import pairwise
from math import inf, nan
from typing import TYPE_CHECKING

from ces_observer.structures.increasing_curves import pieces
from ces_observer.structures.reach import InputLimiter
from ces_observer.structures.side_forces import SideRun
from ces_observer.structures.structure import OperatingRange
from ces_observer.structures.valve_path import ValveRun

if TYPE_CHECKING:
    from ces_observer.structures.chambers import Chambers

QUICK_STEPS = 3  # from pieces to pieces, before the search
MAX_STEPS = 300  # of the search: each leaves a piece for good, or halves the bracket
CLOSE = 1e-12  # relative change of the pressures that ends a step

ValvePiece = tuple[float, float, float, float, float, float]
"""Flow and width [m/s] of a piece, force [N] at its left node and rise to the right one, and how far the next row's
differ from them."""


class ChambersRun:
    """The free run of a model with chambers; `clamped` is True if the last inputs were outside the envelope."""

    def __init__(self, model: Chambers, within: OperatingRange) -> None:
        rate = within.rate_Hz
        self._inputs = InputLimiter(within, model.reach)
        self._valve = ValveRun(model.valve, 1.0 / rate)
        self._side = SideRun(model.side, 1.0 / rate)
        self._rubs, self._growth = bool(model.side.friction), model.friction_growth_1_N
        self._drops, self._checks = model.check.at[1:-1], pieces(model.check.at, model.check.values)
        self._suctions, self._refills = model.refill.at[1:-1], pieces(model.refill.at, model.refill.values)
        rows = model.map.rows
        self._top = len(rows) - 1
        self._rows = [_blend(model.map.at, *pair) for pair in pairwise((*rows, rows[-1]))]
        self._ratio = 1.0 + model.area_ratio
        self._stored = tuple(rate * one for one in (model.compression_m_N, model.rebound_m_N, model.mount_m_N))
        self._limits = within.force_N
        self.reset()

    @property
    def clamped(self) -> bool:
        """True if the last inputs lay outside the envelope."""
        return self._inputs.outside

    def reset(self) -> None:
        """Forget the past: chambers at the reservoir's pressure."""
        self._valve.reset()
        self._side.reset()
        self.pressures = 0.0, 0.0
        self._pieces = 0, 0, 0
        self._inputs.outside = False

    def tick(self, position: float, speed: float, current: float) -> float:
        """Return the force [N] at this tick; infinite if it left the force envelope."""
        position, speed, current = self._inputs.limit(position, speed, current)
        drive, force = self._side.tick(position, speed)
        p_c, p_r = self.advance(drive, self._valve.tick(current))
        force += self._ratio * p_c - p_r
        if self._rubs:
            force += self._side.friction(drive) * (1.0 + self._growth * p_r if p_r > 0.0 else 1.0)
        low, high = self._limits
        return force if low <= force <= high else inf

    def advance(self, drive: float, setting: float) -> tuple[float, float]:
        """Step both pressures [N] at a drive [m/s] and a setting of the valve."""
        share = setting * self._top
        row = int(share)
        share -= row
        valves = self._rows[row]
        i, j, k = self._pieces
        for _ in range(QUICK_STEPS):
            p_c, p_r, left, right = self._solve(i, j, valves[k], share, drive)
            before = i, j, k
            i, j = bisect_left(self._drops, p_c - p_r), bisect_left(self._suctions, -p_c)
            if not left < p_r <= right:
                k = _pick(valves, share, p_r)
            if before == (i, j, k):
                break
        else:
            p_c, p_r = self._search(valves, share, drive)
        self._pieces = i, j, k
        self.pressures = p_c, p_r
        return p_c, p_r

    def _search(self, valves: Sequence[ValvePiece], share: float, drive: float) -> tuple[float, float]:
        """Solve the step by Newton's method for p_r, with the p_c that belongs to it, in a bracket that halves."""
        low, high, p_r = -inf, inf, self.pressures[1]
        for _ in range(MAX_STEPS):
            p_c = self._balance(p_r, drive)
            i, j = bisect_left(self._drops, p_c - p_r), bisect_left(self._suctions, -p_c)
            p_c, new, *_ = self._solve(i, j, valves[_pick(valves, share, p_r)], share, drive)
            if abs(new - p_r) <= CLOSE * (1.0 + abs(new)):
                return p_c, new
            low, high = (p_r, high) if new > p_r else (low, p_r)
            p_r = new if low < new < high else 0.5 * (low + high)
        return nan, nan  # no force rather than a wrong one

    def _balance(self, p_r: float, drive: float) -> float:
        """Return the p_c [N] at which the flows into the compression chamber balance, for a given p_r [N]."""
        (c_c, _, mount), r, (old_c, old_r) = self._stored, self._ratio, self.pressures
        stored, pushed = c_c + r * r * mount, r * mount * (p_r - old_r) + r * drive
        low, high, p_c = -inf, inf, old_c
        for _ in range(MAX_STEPS):
            at, check, across = self._checks[bisect_left(self._drops, p_c - p_r)]
            check += across * (p_c - p_r - at)
            at, refill, sucked = self._refills[bisect_left(self._suctions, -p_c)]
            refill -= sucked * (p_c + at)
            missing = stored * (p_c - old_c) - pushed + check - refill
            before, p_c = p_c, p_c - missing / (stored + across + sucked)
            if abs(p_c - before) <= CLOSE * (1.0 + abs(p_c)):
                break
            low, high = (before, high) if p_c > before else (low, before)
            p_c = p_c if low < p_c < high else 0.5 * (low + high)
        return p_c

    def _solve(
        self, i: int, j: int, valve: ValvePiece, share: float, drive: float
    ) -> tuple[float, float, float, float]:
        """Return both pressures [N] after a step on these pieces, and the ends [N] of the valve's piece."""
        old_c, old_r = self.pressures
        c_c, c_r, mount = self._stored
        at, flow, across = self._checks[i]
        check = flow + across * (old_c - old_r - at)
        at, flow, sucked = self._refills[j]
        refill = flow - sucked * (old_c + at)
        flow, width, left, rise, higher, steeper = valve
        left += share * higher
        rise += share * steeper
        through = width / rise
        valved = flow + through * (old_r - left)
        c_c += sucked
        c_r += through
        r = self._ratio
        x = mount * ((r - 1.0) * check + refill - r * valved)
        y = across * ((r - 1.0) * drive + refill - valved)
        det = c_c * (c_r + mount + across) + (r * r * mount + across) * c_r + mount * across * (r - 1.0) ** 2
        return (
            old_c + (c_r * (r * drive - check + refill) + x + y) / det,
            old_r + (c_c * (check - drive - valved) + r * x + y) / det,
            left,
            left + rise,
        )


def _blend(at: Sequence[float], below: Sequence[float], above: Sequence[float]) -> list[ValvePiece]:
    """Return the pieces of the curves between two rows of the valve's map."""
    return [
        (x0, x1 - x0, a0, a1 - a0, b0 - a0, (b1 - b0) - (a1 - a0))
        for (x0, x1), (a0, a1), (b0, b1) in zip(pairwise(at), pairwise(below), pairwise(above), strict=True)
    ]


def _pick(valves: Sequence[ValvePiece], share: float, at: float) -> int:
    """Return the index of the piece that holds the force `at` [N] of a curve between two rows."""
    return bisect_left(valves, at, 1, key=lambda piece: piece[2] + share * piece[4]) - 1
