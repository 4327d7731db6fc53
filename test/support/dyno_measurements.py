"""Measurements of a damper dyno: steady forces, loops over a cycle, and the response to a step of current."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_rig.dampers.hydraulic.parameters import Damper, HydraulicDamper
from ces_rig.dampers.stepper import DamperStepper, SimulatedRun, simulate, spline_speed

Array = NDArray[np.float64]
STEP = 0.25e-3  # [s]


@dataclass(frozen=True)
class Cycle:
    """One settled cycle: arrays of shape (n,); force without the gas force at mid-stroke."""

    stroke_m: Array
    speed_m_s: Array
    force_N: Array


def steady_force(damper: Damper, speed_m_s: float, current_A: float) -> float:
    """Return the force [N] at mid-stroke after a run there at constant speed, without the gas force.

    Positive speed is compression; the run begins 40 mm before mid-stroke.
    """
    time = np.arange(0.0, 0.040 / abs(speed_m_s) + STEP, STEP)
    stroke = speed_m_s * (time - time[-1])
    stepper = DamperStepper(HydraulicDamper(damper), STEP)
    stepper.settle(stroke[0], 0.0, current_A)
    force = stepper.advance(stroke, np.full_like(time, speed_m_s), np.full_like(time, current_A))
    return float(force[-1]) - stepper.rest_N


def cycle(damper: Damper, amplitude_m: float, frequency_Hz: float, current_A: float, cycles: int = 4) -> Cycle:
    """Return the last of some sine cycles at a constant current."""
    n = round(1.0 / frequency_Hz / STEP)
    phase = 2 * np.pi * np.arange(cycles * n + 1) / n
    rise = np.minimum(phase / (2 * np.pi), 1.0)
    stroke = amplitude_m * rise**2 * (3 - 2 * rise) * np.sin(phase)
    interval = 1.0 / frequency_Hz / n
    run = simulate(HydraulicDamper(damper), interval, stroke, np.full_like(stroke, current_A))
    last = slice(len(stroke) - 1 - n, len(stroke) - 1)
    speed = spline_speed(run.time_s, stroke)
    return Cycle(stroke[last], speed[last], run.tared_N[last])


def current_step(damper: Damper, speed_m_s: float, from_A: float, to_A: float) -> tuple[SimulatedRun, float]:
    """Return a run at constant speed with a current step, and the time [s] of the step (at mid-stroke)."""
    half = 0.045 / abs(speed_m_s)
    time = np.arange(0.0, 2 * half, STEP)
    current = np.where(time < half, from_A, to_A)
    return simulate(
        HydraulicDamper(damper), STEP, speed_m_s * (time - half), current, np.full_like(time, speed_m_s)
    ), half


def rise_time(run: SimulatedRun, step_s: float, share: float = 0.63, settle_s: float = 0.08) -> float:
    """Return the time [s] after the step at which the force has covered `share` of its change within `settle_s`."""
    start = float(np.interp(step_s, run.time_s, run.force_N))
    end = float(np.interp(step_s + settle_s, run.time_s, run.force_N))
    gone = (run.force_N - start) / (end - start)
    after = np.flatnonzero((run.time_s > step_s) & (gone >= share))
    return float(run.time_s[after[0]]) - step_s
