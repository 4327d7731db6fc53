"""A live rig: commands go in, sensor readings come out, tick by tick. Without ROS and clock: the caller keeps time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import ceil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ces_rig.descriptions import choice, quantity
from ces_rig.drive import vehicle_kernel as qv
from ces_rig.errors import RigError
from ces_rig.experiment import GRID_S, Experiment, find_experiment, load_experiment
from ces_rig.live.command import Command
from ces_rig.live.description import DamperDescription, describe_experiment, load_description, with_effects
from ces_rig.live.plant import LivePlant
from ces_rig.live.road import LiveRoad
from ces_rig.live.script import Actuator, Loop, Script, make_experiment_loop, make_loop, make_rest_loop
from ces_rig.live.sensing import LiveSensors
from ces_rig.live.set_points import Follower
from ces_rig.live.vehicle import Vehicle, as_kernel_numbers
from ces_rig.nested_numbers import replace_numbers

SCRIPT, EXPERIMENT, VEHICLE, SET_POINTS = "script", "experiment", "vehicle", "set_points"
ROAD_STREAM = 6  # beside ces_rig.experiment.STREAMS


@dataclass(frozen=True)
class RigSettings:
    """The settings of a live rig."""

    drive: str = choice(SCRIPT, "what moves the damper", (SCRIPT, EXPERIMENT, VEHICLE, SET_POINTS))
    experiment: str = field(
        default="sine_4hz", metadata={"unit": "", "what": "experiment whose stroke is repeated: packaged name or file"}
    )
    damper: str = field(
        default="", metadata={"unit": "", "what": "rig YAML of the damper, any kind; empty: experiment's or packaged"}
    )
    withheld: tuple[str, ...] = field(
        default=(),
        metadata={"unit": "", "what": "effects added: name or 'name: {severity: 1.0, proportion: …}' (docs/rig.md)"},
    )
    rate_hz: int = quantity(1000, "Hz", "samples per second", 200, 2000)
    step_s: float = quantity(0.0, "s", "step of the integrator; 0: that of the recorded rig, 5e-5 or 1e-4", 0.0, 2e-4)
    seed: int = quantity(1, "1", "seed of road, noise stroke and sensors", 0, 2**31)
    noise: float = quantity(1.0, "1", "scale of the sensors' noise; 0: ideal sensors", 0.0, 100.0)
    dropout: float = quantity(0.0, "1", "probability that a sample is lost", 0.0, 0.9)
    safe_current_A: float = quantity(0.4, "A", "current without a command", 0.0, 10.0)
    command_timeout_s: float = quantity(0.1, "s", "age at which a command expires; 0: never", 0.0, 60.0)
    follow_hz: float = quantity(60.0, "Hz", "set points: bandwidth of the actuator", 1.0, 500.0)
    script: Script = field(default_factory=Script)
    vehicle: Vehicle = field(default_factory=Vehicle)


class RigSample(NamedTuple):
    """The result of one tick: readings (None where a sensor gave none) and the vehicle's true signals."""

    tick: int
    position_m: float | None
    current_A: float | None
    force_N: float | None
    body_m_s2: float  # mean over the tick, upwards
    tyre_N: float


class LiveRig:
    """The rig, at rest at tick 0; raises RigError for unusable settings."""

    def __init__(self, settings: RigSettings) -> None:
        self.settings = settings
        experiment = load_experiment(find_experiment(settings.experiment)) if settings.drive == EXPERIMENT else None
        self.damper = with_effects(_load_damper(settings, experiment), settings.withheld)
        self.period_s = 1.0 / settings.rate_hz
        self._count = ceil(self.period_s / GRID_S - 1e-9)
        self._interval_s = self.period_s / self._count
        self._plant = LivePlant(self.damper, self._interval_s, self._count, settings.step_s or None)
        self.command = Command(self.damper.model.allowed_A, settings.safe_current_A, settings.command_timeout_s)
        self.sensors = LiveSensors(self.damper.sensors, settings.seed, settings.rate_hz, self.damper.sensor_effects)
        self.sensors.set_imperfections(settings.noise, settings.dropout)
        self.motion = np.zeros(qv.MOTION_SIZE)
        self._numbers = as_kernel_numbers(settings.vehicle, self.damper.model.reach_m)
        rng = np.random.default_rng([settings.seed, ROAD_STREAM])
        self._road = LiveRoad(settings.vehicle.road_class, settings.vehicle.speed_m_s, self._interval_s, rng)
        self.follower = Follower(settings.follow_hz, self.damper.model.reach_m, self._interval_s)
        self._actuator = self._make_actuator(settings, experiment)
        self.ticks = 0
        self._plant.settle(*self._actuator.start, self.command.at(0.0))

    @property
    def time_s(self) -> float:
        """Seconds since the start."""
        return self.ticks / self.settings.rate_hz

    @property
    def coil_A(self) -> float:
        """True current in the coil [A]."""
        return self._plant.coil_A

    def tick(self) -> RigSample:
        """Advance one tick with the present command."""
        current = self.command.at(self.time_s)
        self.ticks += 1
        motion, before = self.motion, self.motion[qv.BODY_SPEED]
        if self.settings.drive == VEHICLE:
            self._plant.ride(self._numbers, motion, self._road.heights(self._count), current)
        else:
            source = self.follower if self.settings.drive == SET_POINTS else self._actuator
            stroke, speed = source.moves(self._count)
            self._plant.drive(stroke, speed, current)
            motion[qv.STROKE], motion[qv.FORCE] = stroke[-1], self._plant.force_N
        return self._sample(current, (motion[qv.BODY_SPEED] - before) / self.period_s)

    def check(self, values: Mapping[str, Any]) -> None:
        """Raise the RigError that `change` would raise."""
        self._with_changes(values)

    def change(self, values: Mapping[str, Any]) -> None:
        """Change settings in `LIVE`, by dotted name; raises RigError without changing anything."""
        changed, loop = self._with_changes(values)
        if loop is not None:
            self._actuator.change(loop)
        self._road.road_class, self._road.speed_m_s = changed.vehicle.road_class, changed.vehicle.speed_m_s
        self.command.safe_A, self.command.timeout_s = changed.safe_current_A, changed.command_timeout_s
        self.sensors.set_imperfections(changed.noise, changed.dropout)
        self.settings = changed

    def _with_changes(self, values: Mapping[str, Any]) -> tuple[RigSettings, Loop | None]:
        """Return the changed settings, and the script's loop if it is new."""
        for name in values:
            if name not in LIVE:
                raise RigError(f"rig: '{name}' cannot change while the rig runs; expected one of {', '.join(LIVE)}")
        changed = replace_numbers(self.settings, values, "rig")
        if changed.script == self.settings.script or self.settings.drive != SCRIPT:
            return changed, None
        loop = make_loop(changed.script, self._interval_s, changed.seed)
        return changed, loop.require_within(self.damper.model.reach_m)

    def _sample(self, command: float, body: float) -> RigSample:
        motion, sensors = self.motion, self.sensors
        stroke, current, force = sensors.apply_effects(
            self.time_s,
            float(motion[qv.STROKE]),
            command if sensors.commanded else self._plant.coil_A,
            float(motion[qv.FORCE]) + self.damper.rest_N,
        )
        return RigSample(
            self.ticks,
            sensors.position.read(stroke),
            sensors.current.read(current) if self.ticks % sensors.current_every == 0 else None,
            sensors.force.read(force),
            float(body),
            float(motion[qv.TYRE]),
        )

    def _make_actuator(self, settings: RigSettings, experiment: Experiment | None) -> Actuator:
        """Return the actuator: an experiment fades in by itself, a script is blended in from rest."""
        if experiment is not None:
            loop = make_experiment_loop(experiment, self._interval_s).require_within(self.damper.model.reach_m)
            return Actuator(loop, self._interval_s)
        actuator = Actuator(make_rest_loop(), self._interval_s)
        if settings.drive == SCRIPT:
            loop = make_loop(settings.script, self._interval_s, settings.seed)
            actuator.change(loop.require_within(self.damper.model.reach_m))
        return actuator


LIVE = (
    "noise", "dropout", "safe_current_A", "command_timeout_s", "script.kind", "script.amplitude_m",
    "script.frequency_Hz", "vehicle.road_class", "vehicle.speed_m_s",
)  # fmt: skip


def _load_damper(settings: RigSettings, experiment: Experiment | None) -> DamperDescription:
    if settings.damper:
        return load_description(Path(settings.damper).expanduser())
    return describe_experiment(experiment) if experiment else DamperDescription()
