"""An experiment on the virtual rig: its description (YAML) goes in, a recording as from a logger comes out.

Stamps start at a fixed epoch and all random numbers depend on the seed, so an experiment repeats exactly.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ces_identify.config_file import read_yaml_mapping, require_known_keys
from ces_identify.recordings.recording import Channel, Recording
from ces_rig.actuated import simulate_actuated
from ces_rig.closed_loop import simulate_controlled
from ces_rig.dampers.hydraulic.parameters import Damper, load_damper, parse_damper
from ces_rig.dampers.hydraulic.stepper import SimulatedRun, rest_force, simulate
from ces_rig.descriptions import build, fill_defaults, quantity
from ces_rig.drive.currents import Current, make_current
from ces_rig.drive.reg1 import Reg1
from ces_rig.drive.servo_actuator import ServoActuator
from ces_rig.drive.strokes import Stroke, make_stroke
from ces_rig.errors import RigError
from ces_rig.sensors import Sensor, Sensors

Array = NDArray[np.float64]

EPOCH_NS = 1_293_840_000_000_000_000  # 2011-01-01 00:00 UTC, the year of the thesis
GRID_S = 0.5e-3  # [s] grid of the commands and of the true signals
KEYS = (
    "name", "description", "duration_s", "seed", "repeat", "tare", "stroke", "current", "damper", "sensors", "actuator",
)  # fmt: skip
STREAMS = {"stroke": 0, "current": 1, "position": 2, "measured_current": 3, "force": 4, "temperature": 5, "actuator": 7}


@dataclass(frozen=True)
class ExperimentSettings:
    """The settings of an experiment that are single values."""

    name: str = ""
    description: str = ""
    duration_s: float = quantity(30.0, "s", "duration", 0.1, 7200.0)
    seed: int = quantity(1, "1", "seed of all random numbers", 0, 2**31)
    repeat: int = quantity(0, "1", "number of the repetition: other noise, same stroke and current", 0, 2**31)
    tare: bool = True


@dataclass(frozen=True)
class Experiment:
    """Stroke, current, damper and sensors; with `tare` the load cell reads 0 under the gas force alone.

    With an `actuator` the stroke is its command; without one the stroke is exactly as described.
    """

    settings: ExperimentSettings
    stroke: Stroke
    current: Current | Reg1
    damper: Damper
    sensors: Sensors
    actuator: ServoActuator | None = None


@dataclass(frozen=True)
class Truth:
    """Noise-free signals on the uniform grid `time_s`; every array of shape (n,)."""

    time_s: Array
    stroke_m: Array
    commanded_A: Array
    coil_A: Array
    force_N: Array
    oil_degC: Array
    command_m: Array | None = None  # stroke as commanded, if an actuator made `stroke_m` of it


def packaged_experiments() -> dict[str, Path]:
    """Return the experiments that come with the package, by name; those of a folder are `folder/name`."""
    folder = Path(str(files("ces_rig"))) / "experiments"
    paths = sorted(folder.glob("*.yaml")) + sorted(folder.glob("*/*.yaml"))
    return {path.relative_to(folder).with_suffix("").as_posix(): path for path in paths}


def find_experiment(name_or_path: str) -> Path:
    """Return the path of an experiment, a file or a packaged name; raises RigError if it is neither."""
    path = Path(name_or_path)
    if path.is_file():
        return path
    packaged = packaged_experiments()
    if name_or_path not in packaged:
        raise RigError(f"{name_or_path}: no such file or packaged experiment; packaged are {', '.join(packaged)}")
    return packaged[name_or_path]


def load_experiment(path: Path) -> Experiment:
    """Return the experiment described in the YAML file `path`; raises RigError."""
    return parse_experiment(read_yaml_mapping(path, "an experiment description", error=RigError), str(path), path)


def parse_experiment(description: Mapping[str, Any], where: str, path: Path | None = None) -> Experiment:
    """Return the experiment of a `description`; a damper file in it is relative to the folder of `path`."""
    require_known_keys(description, KEYS, where, RigError)
    for key in ("stroke", "current"):
        if key not in description:
            raise RigError(f"{where}: '{key}' is missing; expected a mapping with its kind")
    settings = {f.name: description[f.name] for f in fields(ExperimentSettings) if f.name in description}
    return Experiment(
        build(ExperimentSettings, {"name": path.stem if path else "experiment", **settings}, where),
        make_stroke(_locate_file(description["stroke"], path), f"{where}: stroke"),
        make_current(description["current"], f"{where}: current"),
        _read_damper(description.get("damper", {}), f"{where}: damper", path),
        build(Sensors, fill_defaults(description.get("sensors", {}), Sensors()), f"{where}: sensors"),
        build(ServoActuator, description["actuator"], f"{where}: actuator") if "actuator" in description else None,
    )


def simulate_truth(experiment: Experiment) -> Truth:
    """Run the experiment and return its noise-free signals; raises RigError if the stroke leaves the damper."""
    settings = experiment.settings
    time = np.arange(round(settings.duration_s / GRID_S) + 1, dtype=np.float64) * GRID_S
    described = experiment.stroke.samples(time, _rng(settings.seed, "stroke"))
    run, stroke, command = _drive_damper(experiment, time, described)
    force = run.force_N - (rest_force(experiment.damper) if settings.tare else 0.0)
    return Truth(time, stroke, command, run.state("coil_A"), force, run.state("oil_degC"), described)


def _drive_damper(experiment: Experiment, time_s: Array, described_m: Array) -> tuple[SimulatedRun, Array, Array]:
    """Return the run on the described stroke (n,), the stroke made and the commanded current [A], each (n,)."""
    settings, damper = experiment.settings, experiment.damper
    if experiment.actuator is not None:
        noise, current = _rng(settings.seed, "actuator", settings.repeat), _rng(settings.seed, "current")
        return simulate_actuated(damper, experiment.actuator, time_s, described_m, experiment.current, noise, current)
    if isinstance(experiment.current, Reg1):
        run, command = simulate_controlled(damper, GRID_S, described_m, experiment.current)
    else:
        command = experiment.current.samples(time_s, described_m, _rng(settings.seed, "current"))
        run = simulate(damper, GRID_S, described_m, command)
    return run, described_m, command


def run(experiment: Experiment) -> Recording:
    """Run the experiment and return the recording of its sensors: position, current, force (and temperature)."""
    return measure(experiment, simulate_truth(experiment))


def measure(experiment: Experiment, true: Truth) -> Recording:
    """Return the recording of the signals `true` by the experiment's sensors."""
    settings = experiment.settings
    return measure_signals(true, experiment.sensors, settings.seed, settings.name, settings.repeat)


def measure_signals(true: Truth, sensors: Sensors, seed: int, name: str, repeat: int = 0) -> Recording:
    """Return the recording, with this name, of the signals `true` by `sensors`; `repeat` gives other noise."""
    current = true.coil_A if sensors.current_source == "measured" else true.commanded_A

    def log_channel(channel: str, unit: str, signal: Array, stream: str) -> Channel:
        sensor = getattr(sensors, channel)
        return sensor.measure(channel, unit, true.time_s, signal, EPOCH_NS, _rng(seed, stream, repeat))  # type: ignore[no-any-return]

    channels = [
        log_channel("position", "m", true.stroke_m, "position"),
        log_channel("current", "A", current, "measured_current"),
        log_channel("force", "N", true.force_N, "force"),
    ]
    if sensors.log_temperature:
        channels.append(log_channel("temperature", "degC", true.oil_degC, "temperature"))
    if sensors.log_command and true.command_m is not None:
        channels.append(Sensor().measure("command", "m", true.time_s, true.command_m, EPOCH_NS, _rng(seed, "stroke")))
    return Recording(name, {c.name: c for c in channels})


def with_seed(experiment: Experiment, seed: int) -> Experiment:
    """Return the same experiment with another seed."""
    return replace(experiment, settings=replace(experiment.settings, seed=seed))


def with_repeat(experiment: Experiment, repeat: int) -> Experiment:
    """Return another repetition of the experiment: other noise and disturbance, same stroke and current."""
    return replace(experiment, settings=replace(experiment.settings, repeat=repeat))


def _rng(seed: int, stream: str, repeat: int = 0) -> np.random.Generator:
    """Return a generator of its own for each use, so that a change in one does not affect the others."""
    return np.random.default_rng([seed, STREAMS[stream], *([repeat] if repeat else [])])


def _locate_file(stroke: object, path: Path | None) -> object:
    """Return the description of a stroke with the path of its file relative to the experiment's folder."""
    if isinstance(stroke, Mapping) and stroke.get("kind") == "file" and isinstance(stroke.get("path"), str):
        return {**stroke, "path": str((path.parent if path else Path()) / stroke["path"])}
    return stroke


def _read_damper(description: object, where: str, path: Path | None) -> Damper:
    if isinstance(description, str):
        return load_damper((path.parent if path else Path()) / description)
    return parse_damper(description, where)
