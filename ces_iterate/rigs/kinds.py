"""The kinds of rigs: the plan's section `rig` goes in, a rig that runs commands and returns recordings comes out.

The set points of a run behind topics, and what may go wrong in it, are here too, without ROS.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ces_data.arrays import F
from ces_data.logs.log_mapping import load_dyno_mapping
from ces_data.recording import Recording
from ces_data.signals_file import load_signals
from ces_iterate.commands import RigCommands
from ces_iterate.errors import IterateError
from ces_iterate.plan import Plan
from ces_iterate.rigs.folder import FolderRig
from ces_observer.records import quantity, read_record
from ces_rig.dampers.hydraulic.parameters import Damper, Hydraulic
from ces_rig.dampers.model import DamperModel
from ces_rig.dampers.stepper import simulate
from ces_rig.drive.strokes import smooth_step
from ces_rig.experiment import load_description
from ces_rig.sensors import GRID_S, Sensors, Truth, measure_signals

TOPIC_RIG = "ces_iterate.rigs.topic_rig"  # imported where it is needed only: it needs ROS 2
FOLLOWS_S = 0.15  # the measured stroke is compared with the set points of so many last seconds
GRACE_S = 0.3  # after the start, until the first positions are due


class RigAdapter(Protocol):
    """A rig. A new kind is a module beside this file and settings in `kinds.RIG_SETTINGS` that open it."""

    def run(self, commands: RigCommands, folder: Path) -> Recording:
        """Run the commands and return what was recorded: at least position, current and force.

        `folder` is that of the iteration, for files that the rig needs; it exists. An interrupted run may be started
        again in the same folder. Raises CesError if the rig does not do what is asked.
        """


@dataclass(frozen=True)
class VirtualRig:
    """A simulated damper with sensors; every run begins at rest, cold, at the experiment's first stroke."""

    model: DamperModel = field(default_factory=lambda: Hydraulic(Damper()))
    sensors: Sensors = field(default_factory=Sensors)

    def run(self, commands: RigCommands, folder: Path) -> Recording:
        """Return the recording; the sensors' noise depends on the commands' seed."""
        stroke, current = commands.at(GRID_S)
        run = simulate(self.model, GRID_S, stroke, current)
        true = Truth(run.time_s, stroke, current, run.coil_A, run.tared_N, run.temperature_degC)
        return measure_signals(true, self.sensors, commands.seed, commands.name)


@dataclass(frozen=True)
class VirtualRigSettings:
    """Settings of the virtual rig."""

    damper: str = ""

    def open(self, plan: Plan, where: str) -> RigAdapter:
        """Return the rig of a damper or experiment file (any kind), by default the packaged one."""
        rig = VirtualRig()
        if self.damper:
            description = load_description(plan.path(self.damper))
            rig = VirtualRig(description.model, description.sensors)
        low, high = rig.model.allowed_A
        if plan.limits.low_A < low or plan.limits.high_A > high:
            raise IterateError(f"{where}: the damper takes {low:g} to {high:g} A; set limits: low_A and high_A within")
        if plan.limits.stroke_m + abs(plan.limits.centre_m) > rig.model.reach_m:
            raise IterateError(f"{where}: the damper's ends are at {rig.model.reach_m:g} m; lower limits: stroke_m")
        return rig


@dataclass(frozen=True)
class FolderRigSettings:
    """Settings of a rig that an operator runs."""

    mapping: str = ""
    signals: str = ""
    poll_s: float = quantity(1.0, "s", "time between two looks into the folder", 0.01, 3600.0)

    def open(self, plan: Plan, where: str) -> RigAdapter:
        """Return the rig."""
        mapping = load_dyno_mapping(plan.path(self.mapping)) if self.mapping else None
        return FolderRig(mapping, load_signals(plan.path(self.signals) if self.signals else None), self.poll_s)


@dataclass(frozen=True)
class RosRigSettings:
    """Settings of a rig behind ROS 2 topics."""

    stroke_topic: str = "stroke_command"
    current_topic: str = "valve_command"
    signals: str = ""
    rate_hz: float = quantity(500.0, "Hz", "set points per second", 10.0, 2000.0)
    safe_current_A: float = quantity(0.4, "A", "current before, after and in trouble", 0.0, 100.0)
    deviation_m: float = quantity(0.01, "m", "distance from the set point at which a run is broken off", 1e-5, 1.0)
    approach_s: float = quantity(2.0, "s", "time of the move to the first stroke", 0.1, 60.0)
    silence_s: float = quantity(0.5, "s", "time without a position at which a run is broken off", 0.01, 60.0)

    def open(self, plan: Plan, where: str) -> RigAdapter:
        """Return the rig; raises IterateError if ROS 2 is not there."""
        signals = load_signals(plan.path(self.signals) if self.signals else None)
        try:
            node_module = import_module(TOPIC_RIG)
        except ModuleNotFoundError as error:
            raise IterateError(f"{where}: kind is ros, but {error.name} is missing; source ROS 2 first") from None
        rig: RigAdapter = node_module.TopicRig(self, signals)
        return rig


RIG_SETTINGS: Mapping[str, type[Any]] = {
    "virtual": VirtualRigSettings,
    "folder": FolderRigSettings,
    "ros": RosRigSettings,
}


def open_rig(plan: Plan) -> RigAdapter:
    """Return the plan's rig; raises a CesError that names the key at fault."""
    where, kind = f"{plan.source}: rig", plan.rig.get("kind")
    if not isinstance(kind, str) or kind not in RIG_SETTINGS:
        raise IterateError(f"{where}: kind is {kind!r}; expected one of {', '.join(RIG_SETTINGS)}")
    settings = {key: value for key, value in plan.rig.items() if key != "kind"}
    rig: RigAdapter = read_record(RIG_SETTINGS[kind], settings, where, IterateError).open(plan, where)
    return rig


def smooth_move(from_m: float, to_m: float, duration_s: float, rate_hz: float) -> F:
    """Return the strokes [m] (n,) of a move that begins and ends at rest, `rate_hz` a second."""
    u = np.linspace(0.0, 1.0, max(2, round(duration_s * rate_hz)))
    return np.asarray(from_m + (to_m - from_m) * smooth_step(u))


class RunWatch:
    """Breaks a run off when positions stop coming or the stroke does not follow its set points."""

    def __init__(self, settings: RosRigSettings, name: str, begin_s: float) -> None:
        self._settings, self._name, self._begin_s = settings, name, begin_s
        self._recent: list[float] = []
        self._keep = max(1, round(FOLLOWS_S * settings.rate_hz))

    def check(self, time_s: float, set_point_m: float, newest: tuple[float, float] | None) -> None:
        """Take the set point of `time_s` and the newest position as (time, stroke); raises IterateError."""
        self._recent = [*self._recent[-self._keep :], set_point_m]
        heard_s = newest[0] if newest else self._begin_s
        silent = time_s - heard_s
        if silent > self._settings.silence_s and time_s - self._begin_s > GRACE_S:
            raise IterateError(f"{self._name}: no position for {silent:.2f} s; the run was broken off, check the rig")
        if newest is None:
            return
        low, high = min(self._recent), max(self._recent)
        distance = max(low - newest[1], newest[1] - high, 0.0)
        if distance > self._settings.deviation_m:
            raise IterateError(
                f"{self._name}: the stroke is {1e3 * distance:.1f} mm from its set points, rig: deviation_m allows "
                f"{1e3 * self._settings.deviation_m:g} mm; the run was broken off, check the rig and its zero"
            )
