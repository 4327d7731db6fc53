"""The rig as the learner sees it: an experiment with a commanded stroke goes in, a recording comes out.

`StoredRuns` keeps every recording in a folder. A run that is already there is read instead of repeated, so an
interrupted learning continues where it stopped.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ces_identify.recordings.recording import Channel, Recording
from ces_iterate.stroke.errors import StrokeError
from ces_observer.json_checks import write_atomically
from ces_rig import experiment as virtual
from ces_rig.drive.stroke_file import SampledStroke
from ces_rig.drive.strokes import Common, Stroke

Array = NDArray[np.float64]

MAX_CHANNELS = 20


class StrokeRig(Protocol):
    """Anything that runs an experiment: the virtual rig, or an adapter to a real one."""

    def run(self, experiment: virtual.Experiment) -> Recording:
        """Return the recording, with the channel `position` and, if the rig logs it, `command`."""


class VirtualRig:
    """The virtual rig; its actuator is that of the experiment."""

    def run(self, experiment: virtual.Experiment) -> Recording:
        """Return the recording of position, current, force and command."""
        sensors = replace(experiment.sensors, log_command=True)
        return virtual.run(replace(experiment, sensors=sensors))


class StoredRuns:
    """A rig whose recordings are kept in `folder`, numbered; `on_run` is called before each run that is made."""

    def __init__(self, rig: StrokeRig, folder: Path, on_run: Callable[[int, bool], None] = lambda number, stored: None):
        self._rig, self._folder, self._on_run, self._count = rig, folder, on_run, 0

    def run(self, experiment: virtual.Experiment) -> Recording:
        """Return the stored recording of this run, or run the experiment and store it; raises StrokeError."""
        number, path = self._count, self._folder / f"run_{self._count:02d}.npz"
        self._count += 1
        key = _fingerprint(experiment)
        self._on_run(number, path.exists())
        if path.exists():
            return _read_run(path, key)
        recording = self._rig.run(experiment)
        write_atomically(path, _pack(recording, key))
        return recording


def with_command(experiment: virtual.Experiment, command_m: Array, interval_s: float, run: int) -> virtual.Experiment:
    """Return the experiment with this command (n,) as its stroke, as its repetition number `run`."""
    time = np.arange(len(command_m)) * interval_s
    stroke = Stroke(SampledStroke(time, command_m), Common(fade_s=0.0))
    settings = replace(experiment.settings, duration_s=float(time[-1]), repeat=run)
    return replace(experiment, stroke=stroke, settings=settings)


def _fingerprint(experiment: virtual.Experiment) -> str:
    """Return a hash of what the rig is asked to do."""
    shape = experiment.stroke.shape
    if not isinstance(shape, SampledStroke):
        raise TypeError("a stored run needs a sampled stroke")
    parts = (experiment.settings, experiment.current, experiment.damper, experiment.sensors, experiment.actuator)
    return sha256(repr(parts).encode() + shape.positions_m.tobytes()).hexdigest()


def _pack(recording: Recording, key: str) -> bytes:
    arrays: dict[str, Array] = {"key": np.array(key), "name": np.array(recording.name)}
    for name, channel in recording.channels.items():
        arrays |= {f"{name}.stamps_ns": channel.stamps_ns, f"{name}.values": channel.values}
        arrays[f"{name}.unit"] = np.array(channel.unit)
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
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
