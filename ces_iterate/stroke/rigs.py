"""The rigs of a stroke: a command goes in, a recording comes out, and its position on the grid of the command.

Time 0 is the start of the command. A channel `command` (the stroke as commanded, on the recording's clock) shows when
that was. Without one the position itself is laid over the command: the actuator's mean delay is then taken out of every
run alike, and the piston makes the wanted stroke as much later.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np
from scipy.interpolate import CubicSpline

from ces_data.arrays import F
from ces_data.recording import Channel, Recording
from ces_iterate.commands import INTERVAL_S, RigCommands, read_commands, write_commands
from ces_iterate.errors import StrokeError
from ces_iterate.plan import RigLimits
from ces_iterate.rigs.folder import DROP
from ces_iterate.rigs.kinds import RigAdapter
from ces_rig import experiment as virtual
from ces_rig.drive.currents import Reg1
from ces_rig.drive.sequences import SampledStroke
from ces_rig.drive.strokes import Common, Stroke
from ces_rig.experiment import Experiment
from ces_rig.sensors import STREAMS

COMMAND, POSITION = "command", "position"
MAX_GAP_S = 0.02  # [s] between position samples; longer ones would be bridged by a guess
MAX_MISSING_S = 0.1  # [s] at either end of the command
REFINEMENTS = 5


def position_on_grid(recording: Recording, command_m: F, interval_s: float) -> F:
    """Return the measured position [m] at the times of `command_m` (n,); raises StrokeError for missing samples."""
    name = recording.name
    if POSITION not in recording.channels:
        raise StrokeError(f"{name}: no position in the recording; expected the piston's position")
    start = _find_start(recording, command_m, interval_s)
    time, values = _samples(recording.channel(POSITION), start)
    length = (len(command_m) - 1) * interval_s
    if len(time) < 10 or time[0] > MAX_MISSING_S or time[-1] < length - MAX_MISSING_S:
        span = f"{time[0]:.2f} to {time[-1]:.2f} s" if len(time) else "no samples"
        raise StrokeError(f"{name}: positions cover {span} of the command; expected 0 to {length:.2f} s")
    inside = (time[1:] > 0.0) & (time[:-1] < length)
    gap = float(np.diff(time)[inside].max())
    if gap > MAX_GAP_S:
        raise StrokeError(f"{name}: {1e3 * gap:.0f} ms without a position; expected at most {1e3 * MAX_GAP_S:.0f} ms")
    grid = np.arange(len(command_m), dtype=np.float64) * interval_s
    return np.asarray(CubicSpline(time, values)(np.clip(grid, time[0], time[-1])))


def _samples(channel: Channel, start_ns: float) -> tuple[F, F]:
    """Return finite samples in order of rising times [s] since the start."""
    good = np.isfinite(channel.values)
    stamps, first = np.unique(channel.stamps_ns[good], return_index=True)
    origin = int(stamps[0]) if len(stamps) else 0
    time = ((stamps - origin).astype(np.float64) + (origin - start_ns)) * 1e-9
    return time, channel.values[good][first]


def _find_start(recording: Recording, command_m: F, interval_s: float) -> float:
    """Return the stamp [ns] at which the command began."""
    channel = recording.channel(COMMAND if COMMAND in recording.channels else POSITION)
    if not np.isfinite(channel.values).any():
        return 0.0
    first = float(channel.stamps_ns[0])
    time, values = _samples(channel, first)
    grid = np.arange(time[0], time[-1], interval_s)
    logged, size = np.interp(grid, time, values), len(grid) + len(command_m)
    spectra = np.fft.rfft(logged - logged.mean(), size), np.fft.rfft(command_m - command_m.mean(), size)
    lag = int(np.argmax(np.fft.irfft(spectra[0] * spectra[1].conj(), size)))  # in samples, of the largest correlation
    shift = (lag if lag < len(logged) else lag - size) * interval_s
    spline = CubicSpline(np.arange(len(command_m)) * interval_s, command_m)
    inside = (time > shift + 0.1) & (time < shift + (len(command_m) - 1) * interval_s - 0.1)
    for _ in range(REFINEMENTS):  # Gauss-Newton on the delay
        slope = spline(time[inside] - shift, 1)
        error = values[inside] - spline(time[inside] - shift)
        power = float(slope @ slope)
        shift -= float(slope @ error) / power if power > 0.0 else 0.0
    return first + 1e9 * shift


class StrokeRig(Protocol):
    """Anything that moves a damper by a commanded stroke: the virtual rig, or an adapter to a real one."""

    def run(self, command_m: F, number: int) -> Recording:
        """Return the recording of the command (n,), one sample every INTERVAL_S, in the run of this number.

        Its channel `position` is the piston's; `command`, if the rig logs it, says when the command began.
        """


class VirtualStrokeRig:
    """The virtual rig: an experiment with its current, damper, sensors and actuator, under other commands."""

    def __init__(self, experiment: virtual.Experiment) -> None:
        name = experiment.settings.name
        if experiment.actuator is None:
            raise StrokeError(f"{name}: has no actuator, so its stroke is exact; add 'actuator: {{}}' to the plan")
        self._experiment = replace(experiment, sensors=replace(experiment.sensors, log_command=True))

    def run(self, command_m: F, number: int) -> Recording:
        """Return the recording of position, current, force and command; every number has its own noise."""
        time = np.arange(len(command_m), dtype=np.float64) * INTERVAL_S
        stroke = Stroke(SampledStroke(time, command_m), Common(fade_s=0.0))
        settings = replace(self._experiment.settings, duration_s=float(time[-1]), repeat=number)
        return virtual.run(replace(self._experiment, stroke=stroke, settings=settings))


class CommandedRig:
    """Runs commands with the current of an experiment; every run has a folder of its own in `folder`."""

    def __init__(self, rig: RigAdapter, experiment: Experiment, limits: RigLimits, folder: Path) -> None:
        self._name, self._seed = experiment.settings.name, experiment.settings.seed
        if isinstance(experiment.current, Reg1):
            raise StrokeError(f"{self._name}: reg1 answers a measured force; choose another kind of current")
        self._rig, self._current, self._limits, self._folder = rig, experiment.current, limits, folder

    def run(self, command_m: F, number: int) -> Recording:
        """Return what the rig recorded under the command (n,) every INTERVAL_S; raises CesError."""
        folder = self._folder / f"run_{number:02d}"
        folder.mkdir(parents=True, exist_ok=True)
        time = np.arange(len(command_m), dtype=np.float64) * INTERVAL_S
        current = self._current.samples(time, command_m, np.random.default_rng([self._seed, STREAMS["current"]]))
        asked = RigCommands(f"{self._name.replace('/', '_')}_{number:02d}", command_m, current, number)
        commands, file = self._limits.require_within(asked), folder / "commands.csv"
        if any(folder.glob(f"{DROP}/*")) and not commands.are_like(read_commands(file)):
            raise StrokeError(f"{folder}: has the log of another command; choose another --out, or start anew")
        write_commands(file, commands)
        return self._rig.run(commands, folder)
