"""Numerical kernel of a quarter vehicle with a damper: body on a spring, wheel on a tyre, stops at the stroke's ends.

All quantities are relative to the vehicle at rest on a level road with the damper at mid-stroke; heights, speeds and
forces are positive upwards, stroke and damper force in compression. Semi-implicit Euler at the damper's own step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

BODY, WHEEL, BODY_SPEED, WHEEL_SPEED, STROKE, STROKE_SPEED, FORCE, TYRE, BLOWS, MOTION_SIZE = range(10)
HEIGHT, CURRENT, LATE = 0, 2, 3  # rows of `moves` in `roll`
GRAVITY_M_S2 = 9.81
BLOW_M_S = 0.1  # [m/s] closing speed above which contact counts as a blow


class VehicleNumbers(NamedTuple):
    """The kernel's view of a vehicle: SI units."""

    sprung: float
    unsprung: float
    spring: float
    tyre: float
    tyre_damping: float
    stop_clearance: float
    stop: float
    stop_bend: float
    limit: float


@njit(cache=True)
def roll(b: VehicleNumbers, m: Array, moves: Array, n: int, k: int, interval: float, substeps: int) -> None:
    """Advance the `motion` by the substep `k` (from 1 on) of the interval that ends at column `n` of `moves`."""
    rise = moves[HEIGHT, n] - moves[HEIGHT, n - 1]
    vehicle_step(b, m, moves[HEIGHT, n - 1] + k / substeps * rise, rise / interval, interval / substeps)


@njit(cache=True)
def between(row: Array, n: int, share: float) -> float:
    """Return the value at this share of the interval that ends at column `n`."""
    return float(row[n - 1] + share * (row[n] - row[n - 1]))


@njit(cache=True)
def vehicle_step(b: VehicleNumbers, m: Array, road: float, road_speed: float, h: float) -> None:
    """Advance the `motion` by `h` seconds under the damper force in it; the tyre can only push."""
    bend = m[WHEEL] - m[BODY]
    up = b.spring * bend + stop_force(b, bend) + m[FORCE]
    weight = (b.sprung + b.unsprung) * GRAVITY_M_S2
    tyre = max(b.tyre * (road - m[WHEEL]) + b.tyre_damping * (road_speed - m[WHEEL_SPEED]), -weight)
    m[BODY_SPEED] += h * up / b.sprung
    m[WHEEL_SPEED] += h * (tyre - up) / b.unsprung
    m[BODY] += h * m[BODY_SPEED]
    m[WHEEL] += h * m[WHEEL_SPEED]
    limit_stroke(b, m)
    m[STROKE] = m[WHEEL] - m[BODY]
    m[STROKE_SPEED] = m[WHEEL_SPEED] - m[BODY_SPEED]
    m[TYRE] = weight + tyre


@njit(cache=True)
def stop_force(b: VehicleNumbers, bend: float) -> float:
    """Return the bump stop's force [N] at a stroke [m]; stiffness grows with the square of the deflection."""
    into = abs(bend) - b.stop_clearance
    if into <= 0.0:
        return 0.0
    force = b.stop * into * (1.0 + (into / b.stop_bend) ** 2)
    return force if bend > 0.0 else -force


@njit(cache=True)
def limit_stroke(b: VehicleNumbers, m: Array) -> None:
    """At the metal stops let both masses continue at their common speed: a plastic blow that conserves momentum."""
    bend = m[WHEEL] - m[BODY]
    excess = bend - b.limit if bend > 0.0 else bend + b.limit
    if abs(bend) <= b.limit:
        return
    whole = b.sprung + b.unsprung
    m[BODY] += excess * b.unsprung / whole
    m[WHEEL] -= excess * b.sprung / whole
    closing = m[WHEEL_SPEED] - m[BODY_SPEED] if bend > 0.0 else m[BODY_SPEED] - m[WHEEL_SPEED]
    if closing > 0.0:
        common = (b.sprung * m[BODY_SPEED] + b.unsprung * m[WHEEL_SPEED]) / whole
        m[BODY_SPEED] = m[WHEEL_SPEED] = common
        m[BLOWS] += 1.0 if closing > BLOW_M_S else 0.0
