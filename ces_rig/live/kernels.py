"""Compiled chunks of a live rig: each damper's own kernel from its last input on, driven by hand or by a vehicle.

`moves` (4, n + 1) holds on its rows stroke [m] (or road height [m]), speed [m/s], commanded current [A] and that
current behind the damper's dead time; column 0 is the last input, `n` more follow, one every `interval` seconds. A
damper's coefficients come as an array (`numbers`): to hand seventy numbers over one by one takes as long as ten steps.

Numba's cache watches this file only: touch it after a change in what is called here (test_live_plant.py tells).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.typing import NDArray

from ces_rig.dampers.bouc_wen import kernel as bw
from ces_rig.dampers.bouc_wen.parameters import Numbers as BoucWenNumbers
from ces_rig.dampers.hydraulic import kernel as hy
from ces_rig.dampers.polyviscous import kernel as pv
from ces_rig.dampers.polyviscous.parameters import Numbers as PolyviscousNumbers
from ces_rig.live.vehicle import FORCE, STROKE, STROKE_SPEED, VehicleNumbers, vehicle_step

Array = NDArray[np.float64]

HYDRAULIC = len(hy.Coefficients._fields)
BOUC_WEN = len(BoucWenNumbers._fields)
POLYVISCOUS = len(PolyviscousNumbers._fields)
VEHICLE = len(VehicleNumbers._fields)


@njit(cache=True)
def drive_hydraulic(numbers: Array, state: Array, moves: Array, interval: float, substeps: int, force: Array) -> None:
    """Move the hydraulic damper; `force` (n,) receives its force [N] less the gas force at mid-stroke."""
    c = hy.Coefficients(*to_fixed_tuple(numbers, HYDRAULIC))
    none = np.empty((0, hy.STATE_SIZE))
    hy.advance(c, state, moves[0, 1:], moves[1, 1:], moves[2, 1:], interval, substeps, force, none)
    force -= gas_force(c)


@njit(cache=True)
def drive_bouc_wen(numbers: Array, state: Array, moves: Array, interval: float, substeps: int, force: Array) -> None:
    """Move the MR damper."""
    c = BoucWenNumbers(*to_fixed_tuple(numbers, BOUC_WEN))
    out = np.empty((3, moves.shape[1]))
    bw.go_on(c, state, moves[0], moves[1], moves[2], interval, substeps, out)
    force[:] = out[0, 1:]


@njit(cache=True)
def drive_polyviscous(numbers: Array, state: Array, moves: Array, interval: float, substeps: int, force: Array) -> None:
    """Move the ER damper."""
    c = PolyviscousNumbers(*to_fixed_tuple(numbers, POLYVISCOUS))
    out = np.empty((3, moves.shape[1]))
    pv.go_on(c, state, moves[0], moves[1], moves[2], moves[3], interval, substeps, out)
    force[:] = out[0, 1:]


@njit(cache=True)
def ride_hydraulic(
    numbers: Array, state: Array, vehicle: Array, motion: Array, moves: Array, interval: float, substeps: int
) -> None:
    """Let the vehicle with the hydraulic damper ride over the heights in `moves`; `motion` changes in place."""
    c = hy.Coefficients(*to_fixed_tuple(numbers, HYDRAULIC))
    b = VehicleNumbers(*to_fixed_tuple(vehicle, VEHICLE))
    h, zero = interval / substeps, gas_force(c)
    one, force, none = np.empty((3, 1)), np.empty(1), np.empty((0, hy.STATE_SIZE))
    for n in range(1, moves.shape[1]):
        rise, change = moves[0, n] - moves[0, n - 1], moves[2, n] - moves[2, n - 1]
        for k in range(1, substeps + 1):
            vehicle_step(b, motion, moves[0, n - 1] + k / substeps * rise, rise / interval, h)
            one[0, 0], one[1, 0] = motion[STROKE], motion[STROKE_SPEED]
            one[2, 0] = moves[2, n - 1] + k / substeps * change
            hy.advance(c, state, one[0], one[1], one[2], h, 1, force, none)
            motion[FORCE] = force[0] - zero


@njit(cache=True)
def ride_bouc_wen(
    numbers: Array, state: Array, vehicle: Array, motion: Array, moves: Array, interval: float, substeps: int
) -> None:
    """Let the vehicle with the MR damper ride."""
    c = BoucWenNumbers(*to_fixed_tuple(numbers, BOUC_WEN))
    b = VehicleNumbers(*to_fixed_tuple(vehicle, VEHICLE))
    h, zero = interval / substeps, bw.gas(c, 0.0)
    for n in range(1, moves.shape[1]):
        rise, change = moves[0, n] - moves[0, n - 1], moves[2, n] - moves[2, n - 1]
        for k in range(1, substeps + 1):
            vehicle_step(b, motion, moves[0, n - 1] + k / substeps * rise, rise / interval, h)
            field = bw.field_path(c, state, moves[2, n - 1] + (k - 0.5) / substeps * change, h)
            motion[FORCE] = bw.step(c, state, motion[STROKE], motion[STROKE_SPEED], field, h) - zero


@njit(cache=True)
def ride_polyviscous(
    numbers: Array, state: Array, vehicle: Array, motion: Array, moves: Array, interval: float, substeps: int
) -> None:
    """Let the vehicle with the ER damper ride."""
    c = PolyviscousNumbers(*to_fixed_tuple(numbers, POLYVISCOUS))
    b = VehicleNumbers(*to_fixed_tuple(vehicle, VEHICLE))
    h, zero = interval / substeps, pv.gas(c, 0.0)
    for n in range(1, moves.shape[1]):
        rise = moves[0, n] - moves[0, n - 1]
        change, late_change = moves[2, n] - moves[2, n - 1], moves[3, n] - moves[3, n - 1]
        for k in range(1, substeps + 1):
            vehicle_step(b, motion, moves[0, n - 1] + k / substeps * rise, rise / interval, h)
            r = (k - 0.5) / substeps
            pv.field_path(c, state, moves[2, n - 1] + r * change, moves[3, n - 1] + r * late_change, h)
            motion[FORCE] = pv.step(c, state, motion[STROKE], motion[STROKE_SPEED], h) - zero


@njit(cache=True)
def gas_force(c: Any) -> float:
    """Return the hydraulic damper's gas force [N] at mid-stroke."""
    return float(c.rod_area * (c.gas_pressure - hy.ATMOSPHERE_PA))
