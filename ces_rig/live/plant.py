"""The dampers of the rig as live plants: any kind, with withheld effects.

A plant advances in ticks of a fixed number of grid intervals. Its forces equal those of the batch simulation with the
same commands bit for bit (except for rounding in a dead time).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ces_rig.dampers.kinds import KINDS
from ces_rig.live.description import DamperDescription

Array = NDArray[np.float64]
STROKE, SPEED, CURRENT, LATE, ROWS = 0, 1, 2, 3, 4


class LivePlant:
    """One damper and its state; a tick is `count` grid intervals of `interval_s`. Forces [N] are tared at mid-stroke.

    `step_s` is the integrator's step, or None for that of the batch simulation.
    """

    def __init__(self, damper: DamperDescription, interval_s: float, count: int, step_s: float | None = None) -> None:
        self._kind, self._model = KINDS[damper.kind], damper.model
        self._interval_s = interval_s
        self._substeps = max(1, round(interval_s / (step_s or self._kind.step_s)))
        self._numbers = self._model.coefficients()
        self._moves = np.zeros((ROWS, count + 1))
        self._delay = Delay(self._model.delay_s / interval_s, count)
        self.forces = np.zeros(count)
        self.force_N = self.settle(0.0, 0.0, 0.0)

    def settle(self, stroke_m: float, speed_m_s: float, current_A: float) -> float:
        """Bring the damper to rest at this input and return its force [N]."""
        self._moves[:, -1] = stroke_m, speed_m_s, current_A, current_A
        self._delay.settle(current_A)
        self.state, self.force_N = self._model.settle(stroke_m, speed_m_s, current_A)
        return self.force_N

    def drive(self, stroke_m: Array, speed_m_s: Array, current_A: float) -> None:
        """Advance one tick through strokes and speeds, each (count,), with one command; fills `forces` (count,)."""
        moves = self._prepare_moves(current_A)
        moves[STROKE, 1:], moves[SPEED, 1:] = stroke_m, speed_m_s
        self._kind.drive(self._numbers, self.state, moves, self._interval_s, self._substeps, self.forces)
        self.force_N = self.forces[-1]

    def ride(self, vehicle: Array, motion: Array, heights_m: Array, current_A: float) -> None:
        """Advance one tick with a vehicle over road `heights_m` (count,); updates `motion` (`vehicle_kernel.py`)."""
        moves = self._prepare_moves(current_A)
        moves[STROKE, 1:] = heights_m
        self._kind.ride(self._numbers, self.state, vehicle, motion, moves, self._interval_s, self._substeps)

    @property
    def coil_A(self) -> float:
        """The current in the coil [A]."""
        return float(self.state[self._kind.coil])

    def _prepare_moves(self, current_A: float) -> Array:
        moves = self._moves
        moves[:, 0] = moves[:, -1]
        moves[CURRENT, 1:] = current_A
        moves[LATE, 1:] = current_A if self._delay.none else self._delay.after(current_A)
        return moves


class Delay:
    """A dead time of `intervals` (need not be whole) for commands that last `count` intervals each."""

    def __init__(self, intervals: float, count: int) -> None:
        self.none = intervals <= 0.0
        self._count = count
        self._past = np.zeros(int(intervals) + 2 + count)
        self._at = np.arange(count) + len(self._past) - count - intervals
        self._grid = np.arange(len(self._past), dtype=np.float64)

    def settle(self, value: float) -> None:
        """Set all past values to `value`."""
        self._past[:] = value

    def after(self, value: float) -> Array:
        """Feed `value` for `count` intervals and return the delayed values meanwhile, shape (count,)."""
        self._past[: -self._count] = self._past[self._count :].copy()
        self._past[-self._count :] = value
        return np.asarray(np.interp(self._at, self._grid, self._past))
