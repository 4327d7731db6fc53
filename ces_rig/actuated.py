"""Runs the damper on the servo actuator: a commanded stroke goes in; the run and the stroke it really made come out."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from ces_rig.dampers.hydraulic import kernel as hy
from ces_rig.dampers.hydraulic.coefficients import coefficients
from ces_rig.dampers.hydraulic.live import push
from ces_rig.dampers.hydraulic.parameters import Damper
from ces_rig.dampers.hydraulic.stepper import STEP_S, SimulatedRun, check_input, equilibrium, rest_force
from ces_rig.drive import servo_kernel as sk
from ces_rig.drive.currents import Current
from ces_rig.drive.reg1 import Reg1, SpeedForceLoop
from ces_rig.drive.servo_actuator import ServoActuator
from ces_rig.errors import RigError

Array = NDArray[np.float64]


class ActuatedDamper:
    """The damper on its actuator, at rest under the input's first value; `advance` moves both."""

    def __init__(self, damper: Damper, servo: ServoActuator, interval_s: float, start_m: float, current_A: float):
        self._numbers, self._servo = np.array(coefficients(damper)), servo.kernel_numbers()
        self._interval_s, self._substeps = interval_s, max(1, round(interval_s / STEP_S))
        self._last = np.array([start_m, current_A])
        self.state = equilibrium(damper, start_m, 0.0, current_A)
        self.motion = np.zeros(sk.MOTION_SIZE)
        self.motion[[sk.VALVE, sk.POSITION]] = start_m
        self.motion[sk.LOAD] = float(hy.mount_force(coefficients(damper), self.state, start_m, 0.0)[0])
        self.motion[sk.LOAD] -= rest_force(damper)

    def advance(self, input_m: Array, current_A: Array) -> tuple[Array, Array, Array]:
        """Return stroke [m], force [N] without the gas force, each (n,), and states (n, STATE_SIZE) at the inputs."""
        moves = np.stack([np.append(self._last[0], input_m), np.append(self._last[1], current_A)])
        out, states = np.empty((2, len(input_m))), np.empty((len(input_m), hy.STATE_SIZE))
        push(self._numbers, self.state, self._servo, self.motion, moves, self._interval_s, self._substeps, out, states)
        self._last = moves[:, -1]
        return out[0], out[1], states


def simulate_actuated(
    damper: Damper, servo: ServoActuator, time_s: Array, command_m: Array, current: Current | Reg1,
    noise: Generator, current_noise: Generator,
) -> tuple[SimulatedRun, Array, Array]:  # fmt: skip
    """Return the run on the commanded stroke (n,), the stroke that the piston made and the commanded current [A].

    The run's force includes the gas force. A current that follows the stroke follows the commanded one; `reg1` answers
    the stroke made. Raises RigError for an actuator that reaches beyond the damper's ends.
    """
    if servo.stroke_m > damper.body.half_stroke_m:
        ends = f"the damper's ends are at ±{damper.body.half_stroke_m:g} m from mid-stroke"
        raise RigError(f"actuator: stroke_m is {servo.stroke_m:g}; {ends}; choose less")
    loop_input = servo.loop_input(time_s, command_m, noise)
    if isinstance(current, Reg1):
        return _run_with_controller(damper, servo, time_s, loop_input, current)
    command = current.samples(time_s, command_m, current_noise)
    check_input(damper, np.clip(loop_input, -servo.stroke_m, servo.stroke_m), command)
    rig = ActuatedDamper(damper, servo, time_s[1] - time_s[0], loop_input[0], command[0])
    start, load = rig.state.copy(), rig.motion[sk.LOAD]
    stroke, force, states = rig.advance(loop_input[1:], command[1:])
    force = np.append(load, force) + rest_force(damper)
    run = SimulatedRun(time_s, force, np.concatenate([start[np.newaxis], states]))
    return run, np.append(loop_input[0], stroke), command


def _run_with_controller(
    damper: Damper, servo: ServoActuator, time_s: Array, loop_input: Array, reg1: Reg1
) -> tuple[SimulatedRun, Array, Array]:
    interval = time_s[1] - time_s[0]
    loop = SpeedForceLoop(reg1, interval, loop_input[0])
    rig = ActuatedDamper(damper, servo, interval, loop_input[0], loop.current_A)
    stroke, force, command = np.empty((3, len(time_s)))
    states = np.empty((len(time_s), hy.STATE_SIZE))
    stroke[0], force[0], command[0], states[0] = loop_input[0], rig.motion[sk.LOAD], loop.current_A, rig.state
    for n in range(1, len(time_s)):
        one = slice(n, n + 1)
        command[n] = loop.step(stroke[n - 1], force[n - 1])
        stroke[one], force[one], states[one] = rig.advance(loop_input[one], command[one])
    return SimulatedRun(time_s, force + rest_force(damper), states), stroke, command
