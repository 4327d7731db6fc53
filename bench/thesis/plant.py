"""The rig's own damper driven with an estimator's inputs: the cost of a perfect model on a recording.

Estimated ticks of a recording go in (causal speed, filtered position, newest current); the true damper's force at them
comes out. A damper needs a stroke whose slope is its speed, which the two estimates do not satisfy; the stroke is
therefore the integral of the estimated speed, slowly corrected towards the filtered position:

    dx/dt = v_estimated + k (x_filtered - x),  k = 2 pi 1 Hz, by the trapezoidal rule.

The correction only removes the drift: at 0.2 or 5 Hz instead of 1 Hz, J changes by less than 0.1. Nothing is smoothed
or non-causal. The current is the one that the estimator holds, used as the coil current, where it is measured.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from ces_identify.preparation.cost import series_cost
from ces_identify.preparation.series import Series
from ces_rig.dampers.hydraulic.stepper import rest_force, simulate
from ces_rig.experiment import Experiment

F = NDArray[np.float64]

PULL = 2.0 * np.pi * 1.0  # [1/s]


def plant_cost(experiment: Experiment, series: Series) -> float:
    """Return J [%] of the damper driven with the estimates in `series`, a recording of `experiment`."""
    return series_cost(series, simulate_force(experiment, series))


def simulate_force(experiment: Experiment, series: Series) -> F:
    """Return the damper's force [N] at the ticks of `series` (ticks,), which must be one segment without a gap."""
    assert len(series.segments) == 1, f"{series.name}: the rig's recordings have no gaps"
    damper, interval = experiment.damper, 1.0 / series.rate_Hz
    if experiment.sensors.current_source == "measured":
        damper = replace(damper, ces_valve=replace(damper.ces_valve, solenoid_s=0.0))
    stroke = integrate_speed(series.speed, series.position, interval)
    force = simulate(damper, interval, stroke, series.current, series.speed).force_N
    return force - rest_force(damper) if experiment.settings.tare else force


def integrate_speed(speed: F, position: F, interval_s: float) -> F:
    """Return the integral [m] of `speed`, corrected slowly towards `position`, all of shape (ticks,)."""
    half = 0.5 * interval_s
    pushed = speed + PULL * position
    numerator, denominator = [half, half], [1.0 + half * PULL, -(1.0 - half * PULL)]
    before = -denominator[1] * position[0] + half * pushed[0]  # state of the filter after position[0]
    later, _ = lfilter(np.divide(numerator, denominator[0]), np.divide(denominator, denominator[0]), pushed[1:],
                       zi=[before / denominator[0]])  # fmt: skip
    return np.concatenate([position[:1], later])
