"""The virtual rig of any kind of damper (synthetic data)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ces_identify.recordings.recording import Recording
from ces_iterate.commands import Commands
from ces_rig.dampers.hydraulic.effects import Hydraulic
from ces_rig.dampers.hydraulic.parameters import Damper
from ces_rig.dampers.kinds import DamperModel
from ces_rig.experiment import GRID_S, Truth, measure_signals
from ces_rig.live.description import load_description
from ces_rig.sensors import Sensors


@dataclass(frozen=True)
class VirtualRig:
    """A simulated damper with sensors; every run begins at rest, cold, at the experiment's first stroke."""

    model: DamperModel = field(default_factory=lambda: Hydraulic(Damper()))
    sensors: Sensors = field(default_factory=Sensors)

    @staticmethod
    def load(path: Path | None) -> VirtualRig:
        """Return the rig of a damper or experiment file (any kind), by default the packaged one. Raises RigError."""
        if path is None:
            return VirtualRig()
        description = load_description(path)
        return VirtualRig(description.model, description.sensors)

    def run(self, commands: Commands, folder: Path) -> Recording:
        """Return the recording; the sensors' noise depends on the commands' seed."""
        stroke, current = commands.at(GRID_S)
        force, coil, temperature = self.model.run(GRID_S, stroke, current)
        time = commands.time_s[0] + GRID_S * np.arange(len(stroke))
        true = Truth(time, stroke, current, coil, force, temperature)
        return measure_signals(true, self.sensors, commands.seed, commands.name)
