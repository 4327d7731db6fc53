"""Compiled live simulation of the mono-tube damper; `moves` and `numbers` are defined as in the hydraulic one's `live`.

Numba's cache watches this file only: touch it after changing a function that it calls (test_live_plant.py checks this).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.typing import NDArray

from ces_rig.dampers.monotube import kernel as mt
from ces_rig.dampers.monotube.parameters import Numbers
from ces_rig.drive.vehicle_kernel import CURRENT, FORCE, STROKE, STROKE_SPEED, VehicleNumbers, between, roll

Array = NDArray[np.float64]
SIZE = len(Numbers._fields)
VEHICLE = len(VehicleNumbers._fields)


@njit(cache=True)
def drive(numbers: Array, state: Array, moves: Array, interval: float, substeps: int, force: Array) -> None:
    """Move the damper; `force` (n,) receives its force [N] minus the gas force at mid-stroke."""
    out = np.empty((3, moves.shape[1]))
    c = Numbers(*to_fixed_tuple(numbers, SIZE))
    mt.continue_run(c, state, moves[0], moves[1], moves[2], interval, substeps, out)
    force[:] = out[0, 1:]


@njit(cache=True)
def ride(
    numbers: Array, state: Array, vehicle: Array, motion: Array, moves: Array, interval: float, substeps: int
) -> None:
    """Drive the vehicle with the damper over the heights in `moves`; `motion` changes in place."""
    c, b = Numbers(*to_fixed_tuple(numbers, SIZE)), VehicleNumbers(*to_fixed_tuple(vehicle, VEHICLE))
    h, zero = interval / substeps, mt.gas(c, 0.0)
    for n in range(1, moves.shape[1]):
        for k in range(1, substeps + 1):
            roll(b, motion, moves, n, k, interval, substeps)
            field = mt.field_path(c, state, between(moves[CURRENT], n, (k - 0.5) / substeps), h)
            motion[FORCE] = mt.step(c, state, motion[STROKE], motion[STROKE_SPEED], field, h) - zero
