"""The dampers of the rig as live plants: any kind, from its description, effects withheld from simulations included.

A plant goes in ticks of a fixed number of grid intervals; its forces are those of the batch simulation under the same
commands, bit for bit (but for the rounding in a dead time).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ces_rig.dampers.bouc_wen import kernel as bouc_wen_kernel
from ces_rig.dampers.bouc_wen import parameters as bouc_wen
from ces_rig.dampers.hydraulic import kernel as hydraulics
from ces_rig.dampers.hydraulic import stepper
from ces_rig.dampers.hydraulic.coefficients import coefficients
from ces_rig.dampers.hydraulic.effects import Hydraulic
from ces_rig.dampers.polyviscous import kernel as polyviscous_kernel
from ces_rig.dampers.polyviscous import parameters as polyviscous
from ces_rig.live import kernels
from ces_rig.live.description import HYDRAULIC, Description

Array = NDArray[np.float64]
STROKE, SPEED, CURRENT, LATE, ROWS = 0, 1, 2, 3, 4


@dataclass(frozen=True)
class Kind:
    """What is compiled for one kind of damper, and where its state keeps the coil's current."""

    drive: Callable[..., None]
    ride: Callable[..., None]
    coil: int
    step_s: float


KINDS = {
    HYDRAULIC: Kind(kernels.drive_hydraulic, kernels.ride_hydraulic, hydraulics.COIL, stepper.STEP_S),
    "bouc_wen": Kind(kernels.drive_bouc_wen, kernels.ride_bouc_wen, bouc_wen_kernel.COIL, bouc_wen.STEP_S),
    "calibration": Kind(
        kernels.drive_polyviscous, kernels.ride_polyviscous, polyviscous_kernel.COIL, polyviscous.STEP_S
    ),
}


class LivePlant:
    """One damper and its state; `count` grid intervals of `interval_s` make a tick. Forces [N] are tared at mid-stroke.

    `step_s` is the integrator's step, or None for that of the batch simulation.
    """

    def __init__(self, damper: Description, interval_s: float, count: int, step_s: float | None = None) -> None:
        self._kind, self._model = KINDS[damper.kind], damper.model
        self._interval_s = interval_s
        self._substeps = max(1, round(interval_s / (step_s or self._kind.step_s)))
        self._numbers = _numbers(self._model)
        self._moves = np.zeros((ROWS, count + 1))
        self._delay = Delay(_delay_s(self._model) / interval_s, count)
        self.forces = np.zeros(count)
        self.force_N = self.settle(0.0, 0.0, 0.0)

    def settle(self, stroke_m: float, speed_m_s: float, current_A: float) -> float:
        """Bring the damper to rest at this input and return its force [N]."""
        self._moves[:, -1] = stroke_m, speed_m_s, current_A, current_A
        self._delay.settle(current_A)
        self.state, self.force_N = _settled(self._model, self._numbers, stroke_m, speed_m_s, current_A)
        return self.force_N

    def drive(self, stroke_m: Array, speed_m_s: Array, current_A: float) -> None:
        """Go a tick through strokes and speeds, each (count,), under one command; fills `forces` (count,)."""
        moves = self._commanded(current_A)
        moves[STROKE, 1:], moves[SPEED, 1:] = stroke_m, speed_m_s
        self._kind.drive(self._numbers, self.state, moves, self._interval_s, self._substeps, self.forces)
        self.force_N = self.forces[-1]

    def ride(self, vehicle: Array, motion: Array, heights_m: Array, current_A: float) -> None:
        """Go a tick under a vehicle over road `heights_m` (count,); `motion` changes in place (see `vehicle.py`)."""
        moves = self._commanded(current_A)
        moves[STROKE, 1:] = heights_m
        self._kind.ride(self._numbers, self.state, vehicle, motion, moves, self._interval_s, self._substeps)

    @property
    def coil_A(self) -> float:
        """The current in the coil [A]."""
        return float(self.state[self._kind.coil])

    def _commanded(self, current_A: float) -> Array:
        moves = self._moves
        moves[:, 0] = moves[:, -1]
        moves[CURRENT, 1:] = current_A
        moves[LATE, 1:] = current_A if self._delay.none else self._delay.after(current_A)
        return moves


class Delay:
    """A dead time of `intervals` (may be broken) for commands that come `count` intervals at a time."""

    def __init__(self, intervals: float, count: int) -> None:
        self.none = intervals <= 0.0
        self._count = count
        self._past = np.zeros(int(intervals) + 2 + count)
        self._at = np.arange(count) + len(self._past) - count - intervals
        self._grid = np.arange(len(self._past), dtype=np.float64)

    def settle(self, value: float) -> None:
        """Forget the past: it was `value` for long."""
        self._past[:] = value

    def after(self, value: float) -> Array:
        """Take in `count` times `value` and return what comes out meanwhile, shape (count,)."""
        self._past[: -self._count] = self._past[self._count :].copy()
        self._past[-self._count :] = value
        return np.asarray(np.interp(self._at, self._grid, self._past))


def _numbers(model: Any) -> Array:
    if isinstance(model, Hydraulic):
        return np.array(coefficients(model.damper)._replace(**model.extras))
    return np.array(astuple(model.damper))


def _delay_s(model: Any) -> float:
    return 0.0 if isinstance(model, Hydraulic) else float(getattr(model.damper, "delay_s", 0.0))


def _settled(model: Any, numbers: Array, stroke: float, speed: float, current: float) -> tuple[Array, float]:
    """Return the state at rest and the force [N] there."""
    if isinstance(model, Hydraulic):
        state = stepper.equilibrium(model.damper, stroke, speed, current)
        c = hydraulics.Coefficients(*numbers)
        force = hydraulics.mount_force(c, state, stroke, speed)[0] - kernels.gas_force(c)
        return state, float(force)
    if model.kind == "bouc_wen":
        state = np.zeros(bouc_wen_kernel.STATE_SIZE)
        return state, float(bouc_wen_kernel.settle(bouc_wen.Numbers(*numbers), state, stroke, speed, current))
    state = np.zeros(polyviscous_kernel.STATE_SIZE)
    return state, float(polyviscous_kernel.settle(polyviscous.Numbers(*numbers), state, stroke, speed, current))
