"""The rig's damper as a simulation of recordings: recorded position and current go in, force comes out.

The recorded position is noisy and its derivative drives a stiff bushing, so it is first smoothed without delay.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.signal import butter, sosfiltfilt

from ces_data.arrays import F
from ces_rig.dampers.stepper import simulate
from ces_rig.errors import RigError
from ces_rig.experiment import DamperDescription, load_description
from ces_rig.sensors import GRID_S

RigForce = Callable[[F, F, F], F]

SMOOTHING_HZ = 70.0  # [Hz] zero-phase 4th-order low-pass of the position: well above any stroke, well below its noise


def load_rig(path: Path | str) -> RigForce:
    """Return function(time_s, position_m, current_A) -> force_N for a rig description, arrays of shape (n,).

    `path` is an experiment (its damper, `tare` and current source are used) or a damper description (tared, measured
    current) of any kind. The force is noise-free and positive in compression. A measured current is the coil's, so the
    coil's lag is not applied again. Raises RigError.
    """
    return make_rig_force(load_description(Path(path)))


def make_rig_force(damper: DamperDescription) -> RigForce:
    """Return the function that `load_rig` returns, for this damper."""
    measured = damper.sensors.current_source == "measured"
    model = damper.model.without_coil() if measured else damper.model

    def force(time_s: F, position_m: F, current_A: F) -> F:
        time, position, current = _check_samples(time_s, position_m, current_A)
        grid = np.arange(time[0], time[-1] + GRID_S, GRID_S)
        stroke = np.interp(grid, time, position)
        sos, pad = butter(4, SMOOTHING_HZ, fs=1.0 / GRID_S, output="sos"), min(len(grid) - 1, round(0.2 / GRID_S))
        run = simulate(model, GRID_S, sosfiltfilt(sos, stroke, padlen=pad), np.interp(grid, time, current))
        return np.asarray(np.interp(np.asarray(time_s), grid, run.force_N if damper.rest_N else run.tared_N))

    return force


def _check_samples(time_s: F, position_m: F, current_A: F) -> tuple[F, F, F]:
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
