"""A live rig: commands go in, sensor readings come out, tick by tick. Without ROS and clock: the caller keeps time.

The parameters of its node are the fields of its settings.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, count
from math import ceil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from ces_data.config_file import parse_yaml_mapping
from ces_observer.fields import require_known_keys
from ces_observer.nodes.parameter_table import EXECUTOR
from ces_observer.options import Option, as_parameter
from ces_observer.records import choice, part, quantity, walk_record
from ces_rig.dampers.model import WithheldEffect, replace_numbers
from ces_rig.dampers.stepper import GIVEN_STROKE, HYDRAULIC, DamperStepper, Mover
from ces_rig.drive import BODY_SPEED, FORCE, STROKE, TYRE
from ces_rig.drive import VEHICLE as VEHICLE_MOVER
from ces_rig.errors import RigError
from ces_rig.experiments.virtual import DamperDescription, load_description
from ces_rig.live.motion import Actuator, Follower, LiveRoad, Loop, Script, Vehicle, make_loop
from ces_rig.live.timing import Command
from ces_rig.sensors import GRID_S, Sensor, Sensors, Truth, make_rng
from ces_rig.withheld import environment, plants

SCRIPT, VEHICLE, SET_POINTS = "script", "vehicle", "set_points"
ROAD_STREAM = 6  # beside ces_rig.sensors.STREAMS
LIVE_SENSING = ("current_scale", "force_offset", "force_drift", "force_scale", "mains_hum", "position_wave")
LIVE = (
    "noise", "dropout", "safe_current_A", "command_timeout_s", "script.kind", "script.amplitude_m",
    "script.frequency_Hz", "vehicle.road_class", "vehicle.speed_m_s",
)  # fmt: skip


@dataclass(frozen=True)
class RigSettings:
    """The settings of a live rig."""

    drive: str = choice(SCRIPT, "what moves the damper", (SCRIPT, VEHICLE, SET_POINTS))
    damper: str = part(default="", meaning="rig YAML of the damper, any kind; empty: the packaged CES damper")
    withheld: tuple[str, ...] = part(
        default=(), meaning="effects added: name or 'name: {severity: 1.0, proportion: …}' (docs/rig.md)"
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


@dataclass(frozen=True)
class RigNodeSettings:
    """The settings that the node adds to those of a live rig; with `publish_clock` it is the source of time."""

    joint: str = part(default="rear_damper", meaning="joint name, and frame of all stamps")
    stamped_current: bool = part(
        default=False, meaning="publish the current as JointState (effort[joint], in A) instead of Float64"
    )
    publish_clock: bool = part(default=False, meaning="provide simulated time and publish /clock")
    real_time_factor: float = quantity(
        1.0, "1", "with publish_clock: simulated over real time; 0: as fast as the readers allow", 0.0, 1e3
    )
    answer_s: float = quantity(
        0.0, "s", "with real_time_factor 0: longest wait for a command after each sample; 0: none", 0.0, 10.0
    )
    executor: str = choice(str(EXECUTOR.default), EXECUTOR.meaning, EXECUTOR.choices)


OF_THE_NODE, OF_THE_RIG = (
    tuple(
        as_parameter(Option(**vars(one) | {"name": name, "default": value}, live=name in LIVE))
        for name, value, one in walk_record(record)
    )
    for record in (RigNodeSettings(), RigSettings())
)
"""A parameter for each field of the settings, nested ones with a dotted name."""


def read_settings(values: Mapping[str, Any]) -> tuple[RigNodeSettings, RigSettings]:
    """Return the settings from values by parameter name; raises RigError for a value out of range."""
    own, rig = ({spec.name: values[spec.name] for spec in table} for table in (OF_THE_NODE, OF_THE_RIG))
    rig["withheld"] = [text for text in rig["withheld"] if text]
    return replace_numbers(RigNodeSettings(), own, "parameters"), replace_numbers(RigSettings(), rig, "parameters")


class RigSample(NamedTuple):
    """The result of one tick: readings (None where a sensor gave none) and the vehicle's true signals."""

    tick: int
    position_m: float | None
    current_A: float | None
    force_N: float | None
    body_m_s2: float  # mean over the tick, upwards
    tyre_N: float


class LiveRig:
    """The rig, at rest at tick 0; raises RigError for unusable settings.

    A tick is a whole number of intervals of at most the recorded rig's grid. Its forces equal those of a recorded run
    with the same commands bit for bit.
    """

    def __init__(self, settings: RigSettings) -> None:
        self.settings = settings
        damper = load_description(Path(settings.damper).expanduser()) if settings.damper else DamperDescription()
        self.damper = with_effects(damper, settings.withheld)
        model, self.period_s = self.damper.model, 1.0 / settings.rate_hz
        self._count = ceil(self.period_s / GRID_S - 1e-9)
        self._interval_s = self.period_s / self._count
        vehicle = Mover(VEHICLE_MOVER, settings.vehicle.numbers(model.reach_m))
        mover = vehicle if settings.drive == VEHICLE else GIVEN_STROKE
        self._stepper = DamperStepper(model, self._interval_s, settings.step_s or None, mover)
        self.motion = self._stepper.motion
        self.command = Command(model.allowed_A, settings.safe_current_A, settings.command_timeout_s)
        self.sensors = LiveSensors(self.damper.sensors, settings.seed, settings.rate_hz, self.damper.sensor_effects)
        self.sensors.set_imperfections(settings.noise, settings.dropout)
        rng = np.random.default_rng([settings.seed, ROAD_STREAM])
        self._road = LiveRoad(settings.vehicle.road_class, settings.vehicle.speed_m_s, self._interval_s, rng)
        self.follower = Follower(settings.follow_hz, model.reach_m, self._interval_s)
        self._actuator = Actuator(Loop(np.zeros(1), np.zeros(1)), self._interval_s)
        if settings.drive == SCRIPT:  # blended in from rest
            loop = make_loop(settings.script, self._interval_s, settings.seed)
            self._actuator.change(loop.require_within(model.reach_m))
        self.ticks = 0
        self._stepper.settle(current_A=self.command.at(0.0))

    @property
    def time_s(self) -> float:
        """Seconds since the start."""
        return self.ticks / self.settings.rate_hz

    @property
    def coil_A(self) -> float:
        """True current in the coil [A]."""
        return self._stepper.coil_A

    def tick(self) -> RigSample:
        """Advance one tick with the present command."""
        current = self.command.at(self.time_s)
        self.ticks += 1
        motion, before = self.motion, self.motion[BODY_SPEED]
        if self.settings.drive == VEHICLE:
            self._stepper.advance(self._road.heights(self._count), 0.0, current)
        else:
            source = self.follower if self.settings.drive == SET_POINTS else self._actuator
            stroke, speed = source.moves(self._count)
            force = self._stepper.advance(stroke, speed, current)
            motion[STROKE], motion[FORCE] = stroke[-1], force[-1] - self._stepper.rest_N
        return self._sample(current, (motion[BODY_SPEED] - before) / self.period_s)

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
            float(motion[STROKE]),
            command if sensors.commanded else self._stepper.coil_A,
            float(motion[FORCE]) + self.damper.rest_N,
        )
        return RigSample(
            self.ticks,
            sensors.position.read(stroke),
            sensors.current.read(current) if self.ticks % sensors.current_every == 0 else None,
            sensors.force.read(force),
            float(body),
            float(motion[TYRE]),
        )


NORMALS = 1024


class LiveSensor:
    """One sensor with its own stream of random numbers; `noise` scales its imperfections, 0 makes it ideal."""

    def __init__(self, sensor: Sensor, rng: Generator) -> None:
        self._sensor, self._rng = sensor, rng
        self._normals: Iterator[float] = chain.from_iterable(rng.standard_normal(NORMALS).tolist() for _ in count())
        self.noise, self.dropout = 1.0, sensor.dropout

    def read(self, true: float) -> float | None:
        """Return the reading, or None if it is lost."""
        if self.dropout > 0.0 and self._rng.random() < self.dropout:
            return None
        if self.noise == 0.0:
            return true
        sensor = self._sensor
        value = true + sensor.bias + self.noise * sensor.noise * next(self._normals)
        return value if sensor.quantum == 0.0 else sensor.quantum * round(value / sensor.quantum)


class LiveSensors:
    """Position, current and force, the current at its own rate if lower; withheld effects act before the noise."""

    def __init__(
        self, sensors: Sensors, seed: int, rate_Hz: float, effects: Sequence[tuple[str, Mapping[str, float]]] = ()
    ) -> None:
        self.position = LiveSensor(sensors.position, make_rng(seed, "position"))
        self.current = LiveSensor(sensors.current, make_rng(seed, "measured_current"))
        self.force = LiveSensor(sensors.force, make_rng(seed, "force"))
        self.commanded = sensors.current_source == "commanded"
        self.current_every = max(1, round(rate_Hz / sensors.current.rate_Hz))
        self._effects = tuple(effects)
        self._pair = Truth(*(np.zeros(2) for _ in range(6)))  # at the start, for drifts, and now

    def set_imperfections(self, noise: float, dropout: float) -> None:
        """Set the scale of all imperfections and the share of lost samples."""
        for sensor in (self.position, self.current, self.force):
            sensor.noise, sensor.dropout = noise, dropout

    def apply_effects(
        self, time_s: float, stroke_m: float, current_A: float, force_N: float
    ) -> tuple[float, float, float]:
        """Return stroke, current and force of noise-free sensors with the withheld effects."""
        if not self._effects:
            return stroke_m, current_A, force_N
        pair = self._pair
        pair.time_s[1], pair.stroke_m[1], pair.coil_A[1], pair.force_N[1] = time_s, stroke_m, current_A, force_N
        for name, numbers in self._effects:
            pair = environment.SENSING[name](pair, numbers)
        return float(pair.stroke_m[1]), float(pair.coil_A[1]), float(pair.force_N[1])


def with_effects(damper: DamperDescription, effects: Iterable[str]) -> DamperDescription:
    """Return the damper with effects like `name: {severity: s, proportion: p}`; raises RigError for unknown ones."""
    for effect in (parse_effect(text, damper.model.kind) for text in effects):
        numbers = plants.physical_numbers(damper.model, effect)
        if effect.name in environment.SENSING:
            damper = replace(damper, sensor_effects=(*damper.sensor_effects, (effect.name, numbers)))
        else:
            damper = replace(damper, model=damper.model.with_numbers(numbers))
    return damper


def parse_effect(text: str, kind: str) -> WithheldEffect:
    """Return the effect of a line of YAML; severity is 1 and each proportion mid-range by default.

    Raises RigError for one that does not work tick by tick: in sensors with memory or around the damper, or as foam in
    the CES damper.
    """
    excluded = {*environment.SPREADS} - {*LIVE_SENSING} | ({"foaming"} if kind == HYDRAULIC else set())
    known = [name for name in plants.available_effects(kind) if name not in excluded]
    name, numbers = _parse_text(text)
    if name not in known:
        raise RigError(
            f"withheld '{text}': no effect '{name}' on a live {kind} damper; expected one of {', '.join(known)}"
        )
    spreads = plants.list_spreads(kind)[name]
    require_known_keys(numbers, ("severity", *spreads), f"withheld '{text}'", RigError)
    severity = numbers.pop("severity", 1.0)
    return WithheldEffect(name, severity, {**{key: spread.middle for key, spread in spreads.items()}, **numbers})


def _parse_text(text: str) -> tuple[str, dict[str, float]]:
    if text.strip().isidentifier():
        return text.strip(), {}
    try:
        ((name, numbers),) = parse_yaml_mapping(text, "withheld", "an effect", error=RigError).items()
        return str(name), {str(key): float(number) for key, number in numbers.items()}
    except (RigError, AttributeError, TypeError, ValueError):
        raise RigError(f"withheld '{text}': expected a name, or for example 'friction: {{severity: 0.5}}'") from None
