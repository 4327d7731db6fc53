"""Any rig of `ces iterate` (folder, ROS 2) as a rig that strokes are learned on: adds the current to the stroke."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ces_identify.recordings.recording import Recording
from ces_iterate.commands import INTERVAL_S, RigCommands, write_commands
from ces_iterate.plan.limits import RigLimits
from ces_iterate.rigs.rig import RigAdapter
from ces_iterate.stroke.errors import StrokeError
from ces_rig.drive.reg1 import Reg1
from ces_rig.experiment import STREAMS, Experiment

Array = NDArray[np.float64]


class CommandedRig:
    """Runs commands with the current of an experiment; every run has a folder of its own in `folder`."""

    def __init__(self, rig: RigAdapter, experiment: Experiment, limits: RigLimits, folder: Path) -> None:
        if isinstance(experiment.current, Reg1):
            raise StrokeError(
                f"{experiment.settings.name}: reg1 answers a measured force; choose another kind of current"
            )
        self._rig, self._current, self._limits, self._folder = rig, experiment.current, limits, folder
        self._name, self._seed = experiment.settings.name, experiment.settings.seed

    def run(self, command_m: Array, number: int) -> Recording:
        """Return what the rig recorded under the command (n,) every INTERVAL_S; raises CesError."""
        folder = self._folder / f"run_{number:02d}"
        folder.mkdir(parents=True, exist_ok=True)
        commands = self._limits.require_within(self._commands(command_m, number))
        write_commands(folder / "commands.csv", commands)
        return self._rig.run(commands, folder)

    def _commands(self, command_m: Array, number: int) -> RigCommands:
        time = np.arange(len(command_m), dtype=np.float64) * INTERVAL_S
        current = self._current.samples(time, command_m, np.random.default_rng([self._seed, STREAMS["current"]]))
        return RigCommands(f"{self._name.replace('/', '_')}_{number:02d}", command_m, current, number)
