"""The free run of a relaxation model: one force for each tick, from the exact solution of its step.

Seen from the speed q that passes the valve, the force of the oil is piecewise linear and rising: its breakpoints are
those of the valve's map and the speeds at which springs yield. A step starts on the piece of the last one and follows
Newton's method from piece to piece, which mostly ends at once; if not, it finds the piece by bisection.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from math import copysign, inf
from typing import TYPE_CHECKING

from ces_observer.structures.increasing_curves import pieces, place_inside
from ces_observer.structures.reach import InputLimiter
from ces_observer.structures.side_forces import SideRun
from ces_observer.structures.structure import OperatingRange
from ces_observer.structures.valve_path import ValveRun

if TYPE_CHECKING:
    from ces_observer.structures.relaxation import Relaxation

QUICK_STEPS = 8  # from piece to piece, before the bisection
CLOSE = 1e-13  # relative change of the passed speed that ends a step

CurvePiece = tuple[float, float, float, float, float]
"""Speed [m/s], force [N] and slope at the left node of a piece, and how far the next row's force and slope differ."""
SpringPair = tuple[int, float, float, float]
"""Number of a spring, its stiffness times T, its yield force [N] at a row, and how far that at the next row differs."""


class RelaxationRun:
    """The free run of a relaxation model; `clamped` is True if the last inputs were outside the envelope."""

    def __init__(self, model: Relaxation, within: OperatingRange) -> None:
        interval = 1.0 / within.rate_Hz
        self._inputs = InputLimiter(within, model.reach)
        self._valve = ValveRun(model.valve, interval)
        self._side = SideRun(model.side, interval)
        self._numbers = interval, model.compliance_m_N, model.compliance_m_N + interval * model.leak_m_Ns
        self._inner = model.map.at[1:-1]
        self._top = len(model.map.rows) - 1
        self._rows = [_blend(model, n, interval) for n in range(self._top + 1)]
        self._restoring, self._middle = model.restoring, model.mid_stroke_m
        self._limits = within.force_N
        self.reset()

    @property
    def clamped(self) -> bool:
        """True if the last inputs lay outside the envelope."""
        return self._inputs.outside

    def reset(self) -> None:
        """Forget the past."""
        self._valve.reset()
        self._side.reset()
        self._force = self._passed = 0.0
        self._stretched = [0.0] * len(self._restoring)
        self._started = False
        self._inputs.outside = False

    def tick(self, position: float, speed: float, current: float) -> float:
        """Return the force [N] at this tick; infinite if it left the force envelope."""
        position, speed, current = self._inputs.limit(position, speed, current)
        if not self._started:
            self._start(position)
        drive, side = self._side.tick(position, speed)
        force = self._advance(drive, self._valve.tick(current)) + side
        low, high = self._limits
        return force if low <= force <= high else inf

    def _start(self, position: float) -> None:
        """Stretch the restoring springs from mid-stroke."""
        self._started = True
        stretch = position - self._middle
        self._stretched = [min(max(k * stretch, -limit), limit) for k, limit in self._restoring]
        self._force = sum(self._stretched)

    def _advance(self, drive: float, setting: float) -> float:
        """Solve the step for the passed speed q; return the force of the oil [N]."""
        interval, compliance, held = self._numbers
        share = setting * self._top
        row = int(share)
        share -= row
        curve, yields = self._rows[row]
        springs = [(n, step, limit + share * rise) for n, step, limit, rise in yields]
        inner, stretched = self._inner, self._stretched
        target = interval * drive + compliance * self._force
        q = self._passed
        for _ in range(QUICK_STEPS):
            at, force, slope, rise, steeper = curve[bisect_left(inner, q)]
            slope += share * steeper
            force += share * rise - slope * at
            for n, step, limit in springs:
                h = stretched[n]
                if h + step * q > limit:
                    force += limit
                elif h + step * q < -limit:
                    force -= limit
                else:
                    force += h
                    slope += step
            before, q = q, (target - held * force) / (held * slope + interval)
            if -CLOSE <= q - before <= CLOSE or abs(q - before) <= CLOSE * abs(q):
                break
        else:
            q, force, slope = self._search(target, curve, share, springs)
        force += slope * q
        for n, step, limit in springs:
            h = stretched[n] + step * q
            stretched[n] = limit if h > limit else -limit if h < -limit else h
        self._passed, self._force = q, force
        return force

    def _search(
        self, target: float, curve: Sequence[CurvePiece], share: float, springs: Sequence[tuple[int, float, float]]
    ) -> tuple[float, float, float]:
        """Return the passed speed [m/s], and the force at q = 0 and slope of its piece; bisects the breakpoints."""
        interval, _, held = self._numbers
        yields = [(side * limit - self._stretched[n]) / step for n, step, limit in springs for side in (-1.0, 1.0)]
        ends = sorted([*self._inner, *yields])

        def line(q: float) -> tuple[float, float]:
            at, force, slope, rise, steeper = curve[bisect_left(self._inner, q)]
            slope += share * steeper
            force += share * rise - slope * at
            for n, step, limit in springs:
                h = self._stretched[n]
                if abs(h + step * q) > limit:
                    force += copysign(limit, h + step * q)
                else:
                    force, slope = force + h, slope + step
            return force, slope

        def excess(q: float) -> float:
            force, slope = line(q)
            return held * (force + slope * q) + interval * q - target

        force, slope = line(place_inside(ends, bisect_left(ends, 0.0, key=excess)))
        return (target - held * force) / (held * slope + interval), force, slope


def _blend(model: Relaxation, row: int, interval: float) -> tuple[list[CurvePiece], list[SpringPair]]:
    """Return the curves' pieces and the yield forces between a row and the next; the last row is its own next."""
    following = min(row + 1, len(model.map.rows) - 1)
    here, there = (pieces(model.map.at, model.map.rows[n]) for n in (row, following))
    curve = [(x, y, slope, b - y, steeper - slope) for (x, y, slope), (_, b, steeper) in zip(here, there, strict=True)]
    springs = [(one.yield_N[row], one.yield_N[following], one.stiffness_N_m) for one in model.springs]
    return curve, [(n, k * interval, low, high - low) for n, (low, high, k) in enumerate(springs)]
