"""The rig's damper as a simulation of recordings: recorded position and current go in, force comes out.

The recorded position is noisy and its derivative drives a stiff bushing, so it is first smoothed without delay.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from ces_identify.config_file import read_yaml_mapping
from ces_rig.dampers.hydraulic.parameters import Damper, parse_damper
from ces_rig.dampers.hydraulic.stepper import rest_force, simulate
from ces_rig.dampers.kinds import read_lumped
from ces_rig.errors import RigError
from ces_rig.experiment import GRID_S, parse_experiment

Array = NDArray[np.float64]
RigForce = Callable[[Array, Array, Array], Array]

SMOOTHING_HZ = 70.0  # [Hz] zero-phase 4th-order low-pass of the position: well above any stroke, well below its noise


def load_rig(path: Path | str) -> RigForce:
    """Return function(time_s, position_m, current_A) -> force_N for a rig description, arrays of shape (n,).

    `path` is an experiment (its damper, `tare` and current source are used) or a damper description (tared, measured
    current) of any kind. The force is noise-free and positive in compression. A measured current is the coil's, so the
    coil's lag is not applied again. Raises RigError.
    """
    path = Path(path)
    description = read_yaml_mapping(path, "a damper or an experiment", error=RigError)
    lumped = read_lumped(description, str(path))
    if lumped is not None:
        driven = lumped.without_coil()
        return _from_samples(lambda stroke, current: driven.run(GRID_S, stroke, current)[0])
    if "stroke" in description:
        experiment = parse_experiment(description, str(path), path)
        measured = experiment.sensors.current_source == "measured"
        return make_rig_force(experiment.damper, experiment.settings.tare, measured)
    return make_rig_force(parse_damper(description, str(path)))


def make_rig_force(damper: Damper, tare: bool = True, measured_current: bool = True) -> RigForce:
    """Return the function that `load_rig` returns, for this damper."""
    driven = replace(damper, ces_valve=replace(damper.ces_valve, solenoid_s=0.0)) if measured_current else damper
    zero = rest_force(damper) if tare else 0.0
    return _from_samples(lambda stroke, current: simulate(driven, GRID_S, stroke, current).force_N - zero)


def _from_samples(run: Callable[[Array, Array], Array]) -> RigForce:
    """Turn a function of stroke and current on the rig's grid into one of recorded samples."""

    def force(time_s: Array, position_m: Array, current_A: Array) -> Array:
        time, position, current = _check_samples(time_s, position_m, current_A)
        grid = np.arange(time[0], time[-1] + GRID_S, GRID_S)
        stroke = _smooth(np.interp(grid, time, position))
        return np.asarray(np.interp(np.asarray(time_s), grid, run(stroke, np.interp(grid, time, current))))

    return force


def _smooth(position: Array) -> Array:
    sos = butter(4, SMOOTHING_HZ, fs=1.0 / GRID_S, output="sos")
    pad = min(len(position) - 1, round(0.2 / GRID_S))
    return np.asarray(sosfiltfilt(sos, position, padlen=pad))


def _check_samples(time_s: Array, position_m: Array, current_A: Array) -> tuple[Array, Array, Array]:
    """Return the three as floats, sorted by time, without repeated times."""
    time, position, current = (np.asarray(a, dtype=np.float64) for a in (time_s, position_m, current_A))
    if time.ndim != 1 or not time.shape == position.shape == current.shape:
        raise RigError(f"rig: times {time.shape}, positions {position.shape}, currents {current.shape}; expected equal")
    for name, values in (("time", time), ("position", position), ("current", current)):
        if not np.isfinite(values).all():
            raise RigError(f"rig: {name} sample {int(np.argmin(np.isfinite(values)))} is not finite; clean it first")
    time, first = np.unique(time, return_index=True)
    if len(time) < 10 or time[-1] - time[0] < 0.05:
        raise RigError(f"rig: {len(time)} samples; expected at least 10 over at least 0.05 s")
    return time, position[first], current[first]
