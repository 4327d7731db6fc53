"""The rig as the learner sees it: a commanded stroke goes in, a recording of the position comes out.

`StoredRuns` keeps every recording in a folder. A run that is already there is read instead of repeated, so an
interrupted learning continues where it stopped.
"""

from __future__ import annotations

import io
import zipfile
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ces_identify.recordings.recording import Channel, Recording
from ces_iterate.stroke.errors import StrokeError
from ces_observer.json_checks import write_atomically
from ces_rig import experiment as virtual
from ces_rig.drive.stroke_file import SampledStroke
from ces_rig.drive.strokes import Common, Stroke

Array = NDArray[np.float64]

INTERVAL_S = 1e-3  # [s] grid of the commands
MAX_CHANNELS = 20


class StrokeRig(Protocol):
    """Anything that moves a damper by a commanded stroke: the virtual rig, or an adapter to a real one."""

    def run(self, command_m: Array, number: int) -> Recording:
        """Return the recording of the command (n,), one sample every INTERVAL_S, in the run of this number.

        Its channel `position` is the piston's; `command`, if the rig logs it, says when the command began.
        """


class VirtualStrokeRig:
    """The virtual rig: an experiment with its current, damper, sensors and actuator, under other commands."""

    def __init__(self, experiment: virtual.Experiment) -> None:
        if experiment.actuator is None:
            raise StrokeError(
                f"{experiment.settings.name}: has no actuator, so its stroke is exact; add 'actuator: {{}}' to the plan"
            )
        self._experiment = replace(experiment, sensors=replace(experiment.sensors, log_command=True))

    def run(self, command_m: Array, number: int) -> Recording:
        """Return the recording of position, current, force and command; every number has its own noise."""
        time = np.arange(len(command_m), dtype=np.float64) * INTERVAL_S
        stroke = Stroke(SampledStroke(time, command_m), Common(fade_s=0.0))
        settings = replace(self._experiment.settings, duration_s=float(time[-1]), repeat=number)
        return virtual.run(replace(self._experiment, stroke=stroke, settings=settings))


class StoredRuns:
    """A rig whose recordings are kept in `folder`; `plan` says what they depend on besides the command."""

    def __init__(self, rig: StrokeRig, folder: Path, plan: str) -> None:
        self._rig, self._folder, self._plan = rig, folder, plan

    def run(self, command_m: Array, number: int) -> Recording:
        """Return the stored recording of this run, or run the command and store it; raises StrokeError."""
        path = self._folder / f"run_{number:02d}.npz"
        key = sha256(self._plan.encode() + command_m.tobytes()).hexdigest()
        if path.exists():
            return _read_run(path, key)
        recording = self._rig.run(command_m, number)
        write_atomically(path, _pack(recording, key))
        return recording


def _pack(recording: Recording, key: str) -> bytes:
    arrays: dict[str, Any] = {"key": np.array(key), "name": np.array(recording.name)}
    for name, channel in recording.channels.items():
        arrays |= {f"{name}.stamps_ns": channel.stamps_ns, f"{name}.values": channel.values}
        arrays[f"{name}.unit"] = np.array(channel.unit)
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def _read_run(path: Path, key: str) -> Recording:
    try:
        with np.load(path, allow_pickle=False) as arrays:
            if str(arrays["key"]) != key:
                raise StrokeError(
                    f"{path}: is a run of another plan or version; choose another --out, or --overwrite to start anew"
                )
            names = [name.removesuffix(".values") for name in arrays.files if name.endswith(".values")][:MAX_CHANNELS]
            channels = {
                n: Channel(n, str(arrays[f"{n}.unit"]), arrays[f"{n}.stamps_ns"], arrays[f"{n}.values"]) for n in names
            }
            return Recording(str(arrays["name"]), channels)
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise StrokeError(f"{path}: cannot be read as a stored run: {error}; delete it to repeat the run") from None
