"""An experiment on the virtual rig: its description (YAML) goes in, a recording as from a logger comes out.

Stamps start at a fixed epoch and all random numbers depend on the seed, so an experiment repeats exactly. The damper of
an experiment is also a simulation of recordings (`load_rig`): recorded position and current go in, force comes out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.resources import files
from math import copysign
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

from ces_data.arrays import F
from ces_data.config_file import read_yaml_mapping
from ces_data.recording import Recording
from ces_data.waveforms import currents
from ces_data.waveforms.currents import HIGH, LOW, require_range
from ces_data.waveforms.strokes import Current, Stroke
from ces_observer.control.force_controller import CurveError, ForceCurve
from ces_observer.fields import Field
from ces_observer.records import OneOf, Record, part, quantity, read_record
from ces_observer.shapes import Either
from ces_rig.dampers.hydraulic.kernel import LAST_STROKE, rest_force
from ces_rig.dampers.hydraulic.parameters import Damper, HydraulicDamper, load_damper
from ces_rig.dampers.model import RigDamper
from ces_rig.dampers.stepper import (
    GIVEN_STROKE,
    DamperStepper,
    Mover,
    SimulatedRun,
    parse_model,
    simulate,
    spline_speed,
)
from ces_rig.drive import FORCE, SERVO, STROKE, VALVE, ServoActuator
from ces_rig.errors import RigError
from ces_rig.sensors import GRID_S, Sensors, Truth, make_rng, measure_signals

SPEEDS_M_S = (-0.6, -0.4, -0.2, -0.1, -0.05, 0.0, 0.05, 0.1, 0.2, 0.4, 0.6)
FORCES_N = (-2150.0, -2000.0, -1750.0, -1400.0, -900.0, 0.0, 400.0, 600.0, 760.0, 900.0, 1000.0)


@dataclass(frozen=True)
class Reg1:
    """The controller's settings; raises RigError for a reference that is not a curve of a damper."""

    low_A: float = quantity(LOW, "A", "lower end", 0.0, 10.0)
    high_A: float = quantity(HIGH, "A", "upper end", 0.0, 10.0)
    speeds_m_s: tuple[float, ...] = quantity(SPEEDS_M_S, "m/s", "speeds of the reference's points")
    forces_N: tuple[float, ...] = quantity(FORCES_N, "N", "forces of the reference's points")
    gain_A_N: float = quantity(1.5e-4, "A/N", "proportional gain", 0.0, 1.0)
    reset_s: float = quantity(0.010, "s", "reset time of the integral", 1e-4, 1e3)
    filter_s: float = quantity(0.002, "s", "time constant of the speed's filter", 0.0, 1.0)

    def __post_init__(self) -> None:
        require_range(self.low_A, self.high_A)
        try:
            self.reference  # noqa: B018
        except CurveError as error:
            raise RigError(str(error)) from None

    @cached_property
    def reference(self) -> ForceCurve:
        """The desired force over speed."""
        return ForceCurve(self.speeds_m_s, self.forces_N)


class SpeedForceLoop:
    """The controller at work, stepped every `interval_s`; it begins at rest in the middle of the range."""

    def __init__(self, settings: Reg1, interval_s: float, stroke_m: float) -> None:
        self.settings, self.interval_s = settings, interval_s
        self.speed_m_s = 0.0
        self.current_A = self._integral_A = (settings.low_A + settings.high_A) / 2
        self._stroke_m = stroke_m

    def step(self, stroke_m: float, force_N: float) -> float:
        """Return the current [A] that answers a sample of stroke and force."""
        reg1, step = self.settings, self.interval_s
        slope = (stroke_m - self._stroke_m) / step
        self._stroke_m = stroke_m
        self.speed_m_s += (slope - self.speed_m_s) * step / (step + reg1.filter_s)
        error = copysign(1.0, self.speed_m_s) * (reg1.reference.at(self.speed_m_s) - force_N)
        change = reg1.gain_A_N * error * step / reg1.reset_s
        wanted = self._integral_A + change + reg1.gain_A_N * error
        self.current_A = min(max(wanted, reg1.low_A), reg1.high_A)
        if wanted == self.current_A or (wanted - self.current_A) * change < 0.0:
            self._integral_A += change
        return self.current_A


KINDS = {**currents.KINDS, "reg1": Reg1}
CURRENT = Field(kind=OneOf(KINDS))


def make_current(description: object, where: str) -> Current | Reg1:
    """Return the current of the description `{kind: …, its parameters}`; raises RigError."""
    current: Current | Reg1 = CURRENT.check(description, where, RigError)
    return current


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
    """Stroke (an actuator's command if any), current, damper, sensors; `tare`: the cell reads 0 under gas alone."""

    settings: ExperimentSettings = part(inline=True)
    stroke: Stroke = part()
    current: Current | Reg1 = part(kind=CURRENT)
    damper: Damper = part(
        default=Damper(),
        kind=Either(Field(kind=str), Record(Damper, partial=True)),
        meaning="values that differ from the default damper, or the name of a damper file beside this one",
    )
    sensors: Sensors = part(default=Sensors(), kind=Record(Sensors, partial=True))
    actuator: ServoActuator | None = None


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
    """Return the experiment of a `description`; files in it are relative to the folder of `path`."""
    folder, values = path.parent if path else Path(), {"name": path.stem if path else "experiment", **description}
    damper = description.get("damper")
    if isinstance(damper, str):
        del values["damper"]
    experiment = read_record(Experiment, values, where, RigError)
    return replace(experiment, damper=load_damper(folder / damper)) if isinstance(damper, str) else experiment


def simulate_truth(experiment: Experiment) -> Truth:
    """Run the experiment and return its noise-free signals; raises RigError if the stroke leaves the damper."""
    settings = experiment.settings
    time = np.arange(round(settings.duration_s / GRID_S) + 1, dtype=np.float64) * GRID_S
    described = experiment.stroke.samples(time, make_rng(settings.seed, "stroke"))
    run, command = drive_damper(
        experiment.damper, experiment.current, time, described, experiment.actuator, settings.seed, settings.repeat
    )
    force = run.tared_N if settings.tare else run.force_N
    return Truth(time, run.state("stroke_m"), command, run.coil_A, force, run.temperature_degC, described)


def drive_damper(
    damper: Damper, current: Current | Reg1, time_s: F, described_m: F, servo: ServoActuator | None = None,
    seed: int = 1, repeat: int = 0,
) -> tuple[SimulatedRun, F]:  # fmt: skip
    """Run the damper on the described stroke (n,) or, with a servo, on what it makes of that; also return the commands.

    A current that follows the stroke follows the described one. `reg1` answers each sample of the stroke made and the
    damping force (without the gas force at mid-stroke) with the command [A] of the next one. Raises RigError for a
    stroke, or an actuator, that reaches beyond the damper's ends.
    """
    model, interval = HydraulicDamper(damper), float(time_s[1] - time_s[0])
    inputs, speed, reachable = described_m, np.zeros_like(time_s), described_m
    if servo is None:
        speed = spline_speed(time_s, described_m)
    else:
        servo.require_within(model.reach_m)
        inputs = servo.loop_input(time_s, described_m, make_rng(seed, "actuator", repeat))
        reachable = np.clip(inputs, -servo.stroke_m, servo.stroke_m)
    loop, chunk = None, len(time_s)
    if isinstance(current, Reg1):
        loop, chunk = SpeedForceLoop(current, interval, inputs[0]), 1
        command = np.full_like(time_s, loop.current_A)
    else:
        command = current.samples(time_s, described_m, make_rng(seed, "current"))
    model.check_input(reachable, command)
    stepper = DamperStepper(model, interval, mover=GIVEN_STROKE if servo is None else Mover(SERVO, servo.numbers()))
    force, states = np.empty(len(time_s)), np.empty((len(time_s), len(stepper.state)))
    force[0], states[0] = stepper.settle(inputs[0], speed[0], command[0]), stepper.state
    stepper.motion[[VALVE, STROKE, FORCE]] = inputs[0], inputs[0], force[0] - stepper.rest_N
    for start in range(1, len(time_s), chunk):
        part = slice(start, start + chunk)
        if loop is not None:
            command[start] = loop.step(states[start - 1, LAST_STROKE], force[start - 1] - stepper.rest_N)
        force[part] = stepper.advance(inputs[part], speed[part], command[part], states=states[part])
    return SimulatedRun(time_s, force, states, stepper.kind, stepper.rest_N), command


def run(experiment: Experiment) -> Recording:
    """Run the experiment and return the recording of its sensors: position, current, force (and temperature)."""
    return measure(experiment, simulate_truth(experiment))


def measure(experiment: Experiment, true: Truth) -> Recording:
    """Return the recording of the signals `true` by the experiment's sensors."""
    settings = experiment.settings
    return measure_signals(true, experiment.sensors, settings.seed, settings.name, settings.repeat)


def with_seed(experiment: Experiment, seed: int) -> Experiment:
    """Return the same experiment with another seed."""
    return replace(experiment, settings=replace(experiment.settings, seed=seed))


@dataclass(frozen=True)
class DamperDescription:
    """A damper of any kind, its sensors and their effects' physical numbers, and the reading at mid-stroke [N]."""

    model: RigDamper = field(default_factory=lambda: HydraulicDamper(Damper()))
    sensors: Sensors = field(default_factory=Sensors)
    rest_N: float = 0.0
    sensor_effects: tuple[tuple[str, Mapping[str, float]], ...] = ()


def load_description(path: Path) -> DamperDescription:
    """Return the damper in a rig YAML (a damper of any kind, or an experiment); raises RigError."""
    description = read_yaml_mapping(path, "a damper or an experiment", error=RigError)
    if "stroke" in description and description.get("kind", HydraulicDamper.kind) == HydraulicDamper.kind:
        description.pop("kind", None)
        return describe_experiment(parse_experiment(description, str(path), path))
    return DamperDescription(parse_model(description, str(path)))


def describe_experiment(experiment: Experiment) -> DamperDescription:
    """Return the damper and sensors of an experiment."""
    model = HydraulicDamper(experiment.damper)
    rest = 0.0 if experiment.settings.tare else rest_force(model.coefficients())
    return DamperDescription(model, experiment.sensors, rest)


RigForce = Callable[[F, F, F], F]

SMOOTHING_HZ = 70.0  # [Hz] zero-phase 4th-order low-pass of a noisy position, whose derivative drives a stiff bushing


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
        time, position, current = (np.asarray(a, dtype=np.float64) for a in (time_s, position_m, current_A))
        if time.ndim != 1 or not time.shape == position.shape == current.shape:
            shapes = f"times {time.shape}, positions {position.shape}, currents {current.shape}"
            raise RigError(f"rig: {shapes}; expected equal")
        for name, values in (("time", time), ("position", position), ("current", current)):
            if not np.isfinite(values).all():
                bad = int(np.argmin(np.isfinite(values)))
                raise RigError(f"rig: {name} sample {bad} is not finite; clean it first")
        time, first = np.unique(time, return_index=True)
        if len(time) < 10 or time[-1] - time[0] < 0.05:
            raise RigError(f"rig: {len(time)} samples; expected at least 10 over at least 0.05 s")
        grid = np.arange(time[0], time[-1] + GRID_S, GRID_S)
        stroke = np.interp(grid, time, position[first])
        sos, pad = butter(4, SMOOTHING_HZ, fs=1.0 / GRID_S, output="sos"), min(len(grid) - 1, round(0.2 / GRID_S))
        run = simulate(model, GRID_S, sosfiltfilt(sos, stroke, padlen=pad), np.interp(grid, time, current[first]))
        return np.asarray(np.interp(np.asarray(time_s), grid, run.force_N if damper.rest_N else run.tared_N))

    return force
