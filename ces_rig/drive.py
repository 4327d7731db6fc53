"""What moves a damper: a given stroke, a quarter vehicle on a road, or the rig's servo-hydraulic actuator.

`move` advances any of them by one step of the damper's integrator; the damper's force pushes back through the `motion`.

The vehicle is a body on a spring and a wheel on a tyre, with stops at the stroke's ends. All its quantities are
relative to the vehicle at rest on a level road with the damper at mid-stroke; heights, speeds and forces are positive
upwards, stroke and damper force in compression. Semi-implicit Euler at the damper's own step.

The servo actuator is a piston on a stiff, damped position loop. With v the valve's output, u the command after gain,
delay and disturbance, and F the damper's force,

    valve_s * dv/dt = u - v,   d²x/dt² = w² * (v - x - compliance * F) - 2 * damping * w * dx/dt,

that is a mass 1/(compliance w²) on a servo loop of stiffness 1/compliance. Acceleration, speed and stroke are limited.
The valve is stepped exactly for a constant command, the piston by semi-implicit Euler.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass
from math import exp, log1p, pi

import numpy as np
from numba import njit
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.random import Generator

from ces_data.arrays import F
from ces_data.waveforms.strokes import filtered_noise
from ces_observer.records import quantity
from ces_rig.errors import RigError

GIVEN, VEHICLE, SERVO = 0, 1, 2  # what moves the damper
# Rows of `moves` (ROWS, n + 1): stroke [m] (or road height, or the servo's input), its speed, current [A]. Column 0 is
# the last input, one every `interval` seconds follows.
STROKE, STROKE_SPEED, CURRENT, ROWS = 0, 1, 2, 3
# The `motion` (MOTION_SIZE,): STROKE, STROKE_SPEED, the damper's force [N] minus the gas force at mid-stroke, and the
# state of the vehicle or of the servo actuator.
FORCE, BODY, WHEEL, BODY_SPEED, WHEEL_SPEED, TYRE, BLOWS, VALVE, MOTION_SIZE = 2, 3, 4, 5, 6, 7, 8, 9, 10
GRAVITY_M_S2 = 9.81
BLOW_M_S = 0.1  # [m/s] closing speed above which contact counts as a blow
# The kernel's view of a vehicle and of an actuator: SI units, angular frequency in rad/s.
VehicleNumbers = namedtuple(
    "VehicleNumbers", "sprung unsprung spring tyre tyre_damping stop_clearance stop stop_bend limit"
)
ServoNumbers = namedtuple("ServoNumbers", "omega damping valve compliance stroke speed acceleration")
VEHICLE_SIZE, SERVO_SIZE = len(VehicleNumbers._fields), len(ServoNumbers._fields)


@njit(cache=True)
def move(kind: int, numbers: F, m: F, moves: F, n: int, k: int, interval: float, substeps: int) -> None:
    """Advance the `motion` by the substep `k` (from 1 on) of the interval that ends at column `n` of `moves`.

    `kind` is GIVEN (the stroke is the cubic through positions and speeds), VEHICLE or SERVO, `numbers` belong to it.
    """
    if kind == VEHICLE:
        vehicle = VehicleNumbers(*to_fixed_tuple(numbers, VEHICLE_SIZE))
        rise = moves[STROKE, n] - moves[STROKE, n - 1]
        road = moves[STROKE, n - 1] + k / substeps * rise
        vehicle_step(vehicle, m, road, rise / interval, interval / substeps)
    elif kind == SERVO:
        servo = ServoNumbers(*to_fixed_tuple(numbers, SERVO_SIZE))
        servo_step(servo, m, between(moves[STROKE], n, (k - 0.5) / substeps), interval / substeps)
    else:
        x0, v0, x1, v1 = moves[STROKE, n - 1], moves[STROKE_SPEED, n - 1], moves[STROKE, n], moves[STROKE_SPEED, n]
        bend2, bend3 = 3.0 * (x1 - x0) - (2.0 * v0 + v1) * interval, 2.0 * (x0 - x1) + (v0 + v1) * interval
        r = k / substeps
        m[STROKE] = x0 + r * (v0 * interval + r * (bend2 + r * bend3))
        m[STROKE_SPEED] = v0 + r * (2.0 * bend2 + 3.0 * r * bend3) / interval


@njit(cache=True)
def between(row: F, n: int, share: float) -> float:
    """Return the value at this share of the interval that ends at column `n`."""
    return float(row[n - 1] + share * (row[n] - row[n - 1]))


@njit(cache=True)
def first_order_lag(value: float, target: float, lag_s: float, h: float) -> float:
    """Return a first-order lag after `h` seconds."""
    return target + (value - target) * exp(-h / lag_s) if lag_s > 0.0 else target


@njit(cache=True)
def softplus(u: float) -> float:
    """Return log(1 + exp(u)) without overflow."""
    return max(u, 0.0) + log1p(exp(-abs(u)))


@njit(cache=True)
def vehicle_step(b: VehicleNumbers, m: F, road: float, road_speed: float, h: float) -> None:
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
    force = float(b.stop * into * (1.0 + (into / b.stop_bend) ** 2))
    return force if bend > 0.0 else -force


@njit(cache=True)
def limit_stroke(b: VehicleNumbers, m: F) -> None:
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


@njit(cache=True)
def servo_step(s: ServoNumbers, m: F, command: float, h: float) -> None:
    """Advance the `motion` (MOTION_SIZE,) by `h` seconds under the damper's force in it; hard ends stop the piston."""
    m[VALVE] += (command - m[VALVE]) * (1.0 - exp(-h / s.valve) if s.valve > 0.0 else 1.0)
    pull = s.omega**2 * (m[VALVE] - m[STROKE] - s.compliance * m[FORCE])
    push = pull - 2.0 * s.damping * s.omega * m[STROKE_SPEED]
    speed = m[STROKE_SPEED] + h * min(max(push, -s.acceleration), s.acceleration)
    m[STROKE_SPEED] = min(max(speed, -s.speed), s.speed)
    position = m[STROKE] + h * m[STROKE_SPEED]
    m[STROKE] = min(max(position, -s.stroke), s.stroke)
    if m[STROKE] != position:
        m[STROKE_SPEED] = 0.0


SETTLING_S = 2.0  # [s] the disturbance's filter runs before the command begins
FADE_S = 0.1  # [s] the disturbance grows from 0, so that a run begins at rest
NOISE_BANDWIDTH = pi / (2.0 * 2.0**0.5)  # of a second-order Butterworth filter, over its cutoff


@dataclass(frozen=True)
class ServoActuator:
    """The actuator's settings: those of a mid-size servo-hydraulic dyno.

    It follows a command late, with limited bandwidth, and gives way to the damper's force. A small disturbance, new in
    every run, keeps two runs of one command from being equal.
    """

    gain: float = quantity(1.0, "1", "position over command at rest", 0.2, 5.0)
    delay_s: float = quantity(0.004, "s", "dead time of the command", 0.0, 0.2)
    bandwidth_Hz: float = quantity(35.0, "Hz", "natural frequency of the position loop", 0.5, 500.0)
    damping: float = quantity(0.8, "1", "damping ratio of the position loop", 0.1, 5.0)
    valve_s: float = quantity(0.001, "s", "time constant of the servo valve; 0: second order", 0.0, 0.2)
    compliance_m_N: float = quantity(1e-7, "m/N", "deviation per force of the damper", 0.0, 1e-4)
    stroke_m: float = quantity(0.058, "m", "hard ends, either way", 1e-3, 0.5)
    speed_m_s: float = quantity(2.0, "m/s", "largest speed (flow of the valve)", 1e-3, 20.0)
    acceleration_m_s2: float = quantity(400.0, "m/s²", "largest acceleration (pressure)", 0.1, 5e3)
    disturbance_m: float = quantity(20e-6, "m", "RMS of the disturbance of the command, new in every run", 0.0, 0.01)
    disturbance_Hz: float = quantity(10.0, "Hz", "cutoff of the disturbance's second-order filter", 0.1, 200.0)

    def numbers(self) -> F:
        """Return the numbers of `ServoNumbers`, shape (SERVO_SIZE,)."""
        response = 2.0 * pi * self.bandwidth_Hz, self.damping, self.valve_s, self.compliance_m_N
        return np.array([*response, self.stroke_m, self.speed_m_s, self.acceleration_m_s2])

    def require_within(self, reach_m: float) -> None:
        """Raise RigError if the actuator reaches beyond the damper's ends at ±`reach_m`."""
        if self.stroke_m > reach_m:
            ends = f"the damper's ends are at ±{reach_m:g} m from mid-stroke"
            raise RigError(f"actuator: stroke_m is {self.stroke_m:g}; {ends}; choose less")

    def loop_input(self, time_s: F, command_m: F, rng: Generator) -> F:
        """Return the position loop's input [m] at the uniform times (n,): command with gain, delay and disturbance."""
        late = np.interp(time_s - self.delay_s, time_s, command_m)
        rate = 1.0 / (time_s[1] - time_s[0])
        noise = filtered_noise(len(time_s), rate, 2, self.disturbance_Hz, SETTLING_S, rng)
        noise_rms = np.sqrt(2.0 * self.disturbance_Hz / rate * NOISE_BANDWIDTH)
        disturbance = self.disturbance_m / noise_rms * noise * np.minimum(1.0, (time_s - time_s[0]) / FADE_S)
        return np.asarray(self.gain * late + disturbance)
