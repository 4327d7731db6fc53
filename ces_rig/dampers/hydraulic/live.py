"""Compiled live simulation of the hydraulic damper from its last input on, moved by an actuator or a vehicle.

The rows of `moves` (4, n + 1) are stroke [m] (or road height [m]), speed [m/s], commanded current [A] and that current
after the damper's dead time. Column 0 is the last input; `n` more follow, one every `interval` seconds. The
coefficients are passed as an array (`numbers`), because passing seventy scalars takes as long as ten steps.

Numba's cache watches this file only: touch it after changing a function that it calls (test_live_plant.py checks this).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.typing import NDArray

from ces_rig.dampers.hydraulic import kernel as hy
from ces_rig.drive.servo_kernel import LOAD, POSITION, POSITION_SPEED, ServoNumbers, servo_step
from ces_rig.drive.vehicle_kernel import CURRENT, FORCE, STROKE, STROKE_SPEED, VehicleNumbers, between, roll

Array = NDArray[np.float64]
SIZE = len(hy.Coefficients._fields)
VEHICLE = len(VehicleNumbers._fields)
SERVO = len(ServoNumbers._fields)


@njit(cache=True)
def drive(numbers: Array, state: Array, moves: Array, interval: float, substeps: int, force: Array) -> None:
    """Move the damper; `force` (n,) receives its force [N] minus the gas force at mid-stroke."""
    c = hy.Coefficients(*to_fixed_tuple(numbers, SIZE))
    none = np.empty((0, hy.STATE_SIZE))
    hy.advance(c, state, moves[0, 1:], moves[1, 1:], moves[2, 1:], interval, substeps, force, none)
    force -= gas_force(c)


@njit(cache=True)
def ride(
    numbers: Array, state: Array, vehicle: Array, motion: Array, moves: Array, interval: float, substeps: int
) -> None:
    """Drive the vehicle with the damper over the heights in `moves`; `motion` changes in place."""
    c = hy.Coefficients(*to_fixed_tuple(numbers, SIZE))
    b = VehicleNumbers(*to_fixed_tuple(vehicle, VEHICLE))
    h, zero = interval / substeps, gas_force(c)
    one, force, none = np.empty((3, 1)), np.empty(1), np.empty((0, hy.STATE_SIZE))
    for n in range(1, moves.shape[1]):
        for k in range(1, substeps + 1):
            roll(b, motion, moves, n, k, interval, substeps)
            one[0, 0], one[1, 0] = motion[STROKE], motion[STROKE_SPEED]
            one[2, 0] = between(moves[CURRENT], n, k / substeps)
            hy.advance(c, state, one[0], one[1], one[2], h, 1, force, none)
            motion[FORCE] = force[0] - zero


@njit(cache=True)
def push(
    numbers: Array, state: Array, servo: Array, motion: Array, moves: Array, interval: float, substeps: int,
    out: Array, states: Array,
) -> None:  # fmt: skip
    """Move the damper by the servo actuator; the rows of `moves` (2, n + 1) are its input [m] and the current [A].

    `out` (2, n) receives the stroke [m] and the force [N] minus the gas force at mid-stroke, `states` (n, STATE_SIZE)
    the damper's states; `motion` changes in place.
    """
    c = hy.Coefficients(*to_fixed_tuple(numbers, SIZE))
    s = ServoNumbers(*to_fixed_tuple(servo, SERVO))
    h, zero = interval / substeps, gas_force(c)
    one, force, none = np.empty((3, 1)), np.empty(1), np.empty((0, hy.STATE_SIZE))
    for n in range(1, moves.shape[1]):
        for k in range(1, substeps + 1):
            servo_step(s, motion, between(moves[0], n, (k - 0.5) / substeps), h)
            one[0, 0], one[1, 0] = motion[POSITION], motion[POSITION_SPEED]
            one[2, 0] = between(moves[1], n, k / substeps)
            hy.advance(c, state, one[0], one[1], one[2], h, 1, force, none)
            motion[LOAD] = force[0] - zero
        out[0, n - 1], out[1, n - 1] = motion[POSITION], motion[LOAD]
        states[n - 1] = state


@njit(cache=True)
def gas_force(c: hy.Coefficients) -> float:
    """Return the gas force [N] at mid-stroke."""
    return float(c.rod_area * (c.gas_pressure - hy.ATMOSPHERE_PA))
