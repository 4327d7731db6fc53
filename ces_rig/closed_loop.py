"""Runs the damper under a controller: a stroke goes in; the run and the controller's commands come out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ces_rig.dampers.hydraulic import kernel as hy
from ces_rig.dampers.hydraulic.parameters import Damper
from ces_rig.dampers.hydraulic.stepper import SimulatedRun, Stepper, check_input, rest_force, spline_speed
from ces_rig.drive.reg1 import Reg1, SpeedForceLoop

Array = NDArray[np.float64]


def simulate_controlled(
    damper: Damper, interval_s: float, stroke_m: Array, controller: Reg1
) -> tuple[SimulatedRun, Array]:
    """Return the run of `damper` on `stroke_m` (n,) under `controller`, and its commands [A] (n,).

    The controller answers each sample of stroke and damping force (without the gas force at mid-stroke) with the
    command of the next one, `interval_s` later. Raises RigError for a stroke beyond the damper's ends.
    """
    time = np.arange(len(stroke_m), dtype=np.float64) * interval_s
    speed, command = spline_speed(time, stroke_m), np.empty(len(stroke_m))
    force, states = np.empty(len(stroke_m)), np.empty((len(stroke_m), hy.STATE_SIZE))
    loop, zero = SpeedForceLoop(controller, interval_s, stroke_m[0]), rest_force(damper)
    command[0] = loop.current_A
    check_input(damper, stroke_m, command)
    stepper = Stepper(damper, interval_s)
    force[0], states[0] = stepper.reset(stroke_m[0], speed[0], command[0]), stepper.state
    for n in range(1, len(stroke_m)):
        one = slice(n, n + 1)
        command[n] = loop.step(stroke_m[n - 1], force[n - 1] - zero)
        force[one] = stepper.advance(stroke_m[one], speed[one], command[one], states[one])
    return SimulatedRun(time, force, states), command
