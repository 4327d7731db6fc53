"""Numerical kernel of the rig's servo actuator: a piston on a stiff, damped position loop that the damper pushes back.

With v the valve's output, u the command after gain, delay and disturbance, and F the damper's force,

    valve_s * dv/dt = u - v,   d²x/dt² = w² * (v - x - compliance * F) - 2 * damping * w * dx/dt,

that is a mass 1/(compliance w²) on a servo loop of stiffness 1/compliance. Acceleration, speed and stroke are limited.
The valve is stepped exactly for a constant command, the piston by semi-implicit Euler.
"""

from __future__ import annotations

from math import exp
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

VALVE, POSITION, POSITION_SPEED, LOAD, MOTION_SIZE = range(5)


class ServoNumbers(NamedTuple):
    """The kernel's view of an actuator: SI units, angular frequency in rad/s."""

    omega: float
    damping: float
    valve: float
    compliance: float
    stroke: float
    speed: float
    acceleration: float


@njit(cache=True)
def servo_step(s: ServoNumbers, m: Array, command: float, h: float) -> None:
    """Advance the `motion` (MOTION_SIZE,) by `h` seconds under the damper's force in it; hard ends stop the piston."""
    m[VALVE] += (command - m[VALVE]) * (1.0 - exp(-h / s.valve) if s.valve > 0.0 else 1.0)
    pull = s.omega**2 * (m[VALVE] - m[POSITION] - s.compliance * m[LOAD])
    push = pull - 2.0 * s.damping * s.omega * m[POSITION_SPEED]
    speed = m[POSITION_SPEED] + h * min(max(push, -s.acceleration), s.acceleration)
    m[POSITION_SPEED] = min(max(speed, -s.speed), s.speed)
    position = m[POSITION] + h * m[POSITION_SPEED]
    m[POSITION] = min(max(position, -s.stroke), s.stroke)
    if m[POSITION] != position:
        m[POSITION_SPEED] = 0.0
