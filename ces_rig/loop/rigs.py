"""The plan of `ces iterate`, a YAML file, and its rigs, which run commands and return recordings.

Every section of a plan is a frozen dataclass, checked once; `TEMPLATE` explains every key. The set points of a run
behind topics, and what may go wrong in it, are here too, without ROS.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ces_data.arrays import F
from ces_data.bags.reader import read_recording
from ces_data.config_file import packaged_text, read_yaml_mapping
from ces_data.findings import require_usable
from ces_data.logs.log_import import import_log
from ces_data.logs.log_mapping import DynoMapping, load_dyno_mapping
from ces_data.recording import Recording
from ces_data.signals_file import load_signals
from ces_data.waveforms.strokes import smooth_step
from ces_identify.options import DELAY, STARTS, TERMS, THREADS, TIME, IdentifyRequest, structure_option
from ces_observer.errors import CesError
from ces_observer.fields import Field
from ces_observer.json_text import write_atomically
from ces_observer.records import OneOf, choice, declare, in_files, part, quantity, read_record
from ces_observer.signals import Signals
from ces_observer.structures import STRUCTURES
from ces_rig.dampers.hydraulic.parameters import Damper, HydraulicDamper
from ces_rig.dampers.model import RigDamper
from ces_rig.dampers.stepper import simulate
from ces_rig.errors import RigError
from ces_rig.experiments.commands import NEED, RigCommands, RigLimits
from ces_rig.experiments.virtual import load_description
from ces_rig.limits import DesignLimits, LiveLimits
from ces_rig.sensors import GRID_S, Sensors, Truth, measure_signals

SHOWN = "ces iterate --template shows it"
DESIGNED, REPEATED = "designed", "repeated"


@dataclass(frozen=True)
class ExperimentPlan:
    """How the experiments come about."""

    kind: str = choice(DESIGNED, "whether each experiment is designed anew, or one is repeated", (DESIGNED, REPEATED))
    duration_s: float = quantity(15.0, "s", "length of an experiment", 3.0, 600.0)
    commands: str = ""

    def __post_init__(self) -> None:
        if self.commands and self.kind != REPEATED:
            raise RigError(f"'commands' needs kind: {REPEATED}; remove it or repeat it")


@dataclass(frozen=True)
class StopRules:
    """When to stop; the first rule that applies ends the iteration."""

    budget_s: float = quantity(60.0, "s", "recorded seconds to spend in all", 1.0, 1e5)
    target_J: float = quantity(0.0, "%", "cost on a recording that the model has not seen; 0: none", 0.0, 100.0)
    max_iterations: int = quantity(20, "1", "most experiments", 1, 1000)
    fall: float = quantity(0.02, "1", "repeated: smallest relative fall of the cost that goes on", 0.0, 1.0)


@dataclass(frozen=True)
class IdentifyPlan:
    """How a model is identified from all recordings, as the options of `ces identify`."""

    structure: str = declare(structure_option())
    time: float = declare(replace(TIME, low=0.5, high=1e5))
    starts: int = declare(replace(STARTS, default=4))
    terms: int = declare(replace(TERMS, default=25))
    threads: int = declare(replace(THREADS, default=2))
    delay: float = declare(DELAY)

    def request(self, seed: int) -> IdentifyRequest:
        """Return the request for an identification on the whole of all recordings."""
        return IdentifyRequest(**vars(self), seed=seed, split=1.0)


@dataclass(frozen=True)
class Plan:
    """An iteration: `recordings` exist and are identified first, `validate` are only scored.

    `rig` is the description of the rig, which `ces_rig.loop.rigs` checks. Paths are relative to `folder`.
    """

    limits: RigLimits = part(remedy=SHOWN)
    rig: Mapping[str, Any] = part(remedy=SHOWN)
    seed: int = quantity(1, "1", "seed of all random numbers", 0, 2**31)
    experiments: ExperimentPlan = field(default_factory=ExperimentPlan)
    stop: StopRules = field(default_factory=StopRules)
    identify: IdentifyPlan = field(default_factory=IdentifyPlan)
    recordings: tuple[str, ...] = ()
    validate: tuple[str, ...] = ()
    source: str = field(default="", metadata=in_files(None))
    folder: Path = field(default=Path(), metadata=in_files(None))

    def path(self, text: str) -> Path:
        """Return a path of the plan, relative to the plan's folder."""
        return self.folder / Path(text).expanduser()


def load_plan(path: Path) -> Plan:
    """Return the plan of a file; raises RigError of one line that names the file and the key."""
    content = read_yaml_mapping(path, "a plan for ces iterate; ces iterate --template prints one", error=RigError)
    return parse_plan(content, str(path), path.parent)


def parse_plan(content: Mapping[str, Any], source: str, folder: Path) -> Plan:
    """Return the plan of a mapping, as `load_plan`."""
    return replace(read_record(Plan, content, source, RigError), source=source, folder=folder)


OFFERED = ", ".join(one.option for one in STRUCTURES.values() if one.is_offered)
TEMPLATE = packaged_text("ces_rig.loop", "template.yaml").replace("STRUCTURES", OFFERED)


TOPIC_RIG = "ces_rig.loop.topic_rig"  # imported where it is needed only: it needs ROS 2
DROP = "log"  # folder in an iteration's folder, for the operator
TEMPORARY = (".tmp", ".part", ".partial", ".crdownload", ".filepart", "~")

Mark = tuple[tuple[str, int, int], ...]
"""Names, sizes and times [ns] of all files of a log, to see whether it still changes."""


class RigAdapter(Protocol):
    """A rig. A new kind is a module beside this file and settings in `RIG` that open it."""

    def run(self, commands: RigCommands, folder: Path) -> Recording:
        """Run the commands and return what was recorded: at least position, current and force.

        `folder` is that of the iteration, for files that the rig needs; it exists. An interrupted run may be started
        again in the same folder. Raises CesError if the rig does not do what is asked.
        """


@dataclass(frozen=True)
class VirtualRig:
    """A simulated damper with sensors; every run begins at rest, cold, at the experiment's first stroke."""

    model: RigDamper = field(default_factory=lambda: HydraulicDamper(Damper()))
    sensors: Sensors = field(default_factory=Sensors)

    def run(self, commands: RigCommands, folder: Path) -> Recording:
        """Return the recording; the sensors' noise depends on the commands' seed."""
        stroke, current = commands.at(GRID_S)
        run = simulate(self.model, GRID_S, stroke, current)
        true = Truth(run.time_s, stroke, current, run.coil_A, run.tared_N, run.temperature_degC)
        return measure_signals(true, self.sensors, commands.seed, commands.name)


@dataclass(frozen=True)
class FolderRig:
    """Waits for a bag, or with a `mapping` for a log of any format that `ces import` reads, every `poll_s`.

    A log is read only when it is complete: its size and time have not changed between two looks, and it reads without
    an error. One that cannot be read is reported once and looked at again when it changes.
    """

    mapping: DynoMapping | None
    signals: Signals
    poll_s: float = 1.0
    note: Callable[[str], None] = field(default=lambda text: print(text, file=sys.stderr, flush=True))
    sleep: Callable[[float], None] = field(default=time.sleep)

    def run(self, commands: RigCommands, folder: Path) -> Recording:
        """Return the recording that the operator put into `folder`/log; waits until it is there."""
        drop = folder / DROP
        drop.mkdir(exist_ok=True)
        write_atomically(folder / "INSTRUCTIONS.txt", instructions(commands, drop, self.mapping is not None))
        self.note(f"waiting for the log of {commands.name} in {drop} (see INSTRUCTIONS.txt; Ctrl-C may interrupt)")
        seen: dict[Path, Mark] = {}
        refused: dict[Path, Mark] = {}
        while True:
            for path in sorted(drop.iterdir()):
                if path.name.startswith(".") or path.name.endswith(TEMPORARY):
                    continue
                mark = _mark(path)
                if not mark or refused.get(path) == mark:
                    continue
                if seen.get(path) != mark:
                    seen[path] = mark
                    continue
                try:
                    return self._read(path, commands)
                except CesError as error:
                    refused[path] = mark
                    self.note(f"not used: {error}")
            self.sleep(self.poll_s)

    def _read(self, path: Path, commands: RigCommands) -> Recording:
        if path.is_dir() or path.suffix == ".mcap":
            recording = read_recording(path, self.signals, NEED)
        elif self.mapping is not None:
            recording = import_log(path, self.mapping)
        else:
            raise RigError(f"{path}: is not a bag, and rig: mapping does not say how to read it; add a mapping")
        require_usable(recording)
        stamps = recording.channel("position").stamps_ns
        length = float(stamps.max() - stamps.min()) * 1e-9
        if length < DesignLimits.MIN_LOG_SHARE * commands.duration_s:
            raise RigError(f"{path}: {length:.1f} s long; expected the whole of {commands.duration_s:.1f} s")
        return recording


def instructions(commands: RigCommands, drop: Path, mapped: bool) -> str:
    """Return what the operator is to do."""
    what = "the dyno's log, or a rosbag2 folder," if mapped else "the rosbag2 folder (or .mcap file)"
    rest = f"1. Let the damper rest for {commands.rest_s:.0f} s, so that it cools down.\n" if commands.rest_s else ""
    low, high = commands.stroke_m.min(), commands.stroke_m.max()
    return (
        f"Experiment {commands.name}\n\n{rest}"
        f"2. Run commands.csv: time [s], stroke [m] (positive in compression), current [A], a row every 1 ms,\n"
        f"   {commands.duration_s:.1f} s in all, stroke {1e3 * low:.1f} to {1e3 * high:.1f} mm.\n"
        "   Record position, current and force.\n"
        f"3. Put {what} into {drop}. Copy it under a name that ends in .part and rename it when it is complete,\n"
        "   or just copy it: it is read when it no longer changes.\n"
    )


def _mark(path: Path) -> Mark:
    """Return the state of a file or folder, () if it is empty, being renamed, or a bag that is still recorded."""
    if path.is_dir() and not (path / "metadata.yaml").exists():
        return ()
    try:
        files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
        stats = [(str(p), p.stat()) for p in files]
    except OSError:
        return ()
    return tuple((name, s.st_size, s.st_mtime_ns) for name, s in stats) if any(s.st_size for _, s in stats) else ()


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
            raise RigError(f"{where}: the damper takes {low:g} to {high:g} A; set limits: low_A and high_A within")
        if plan.limits.stroke_m + abs(plan.limits.centre_m) > rig.model.reach_m:
            raise RigError(f"{where}: the damper's ends are at {rig.model.reach_m:g} m; lower limits: stroke_m")
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
        """Return the rig; raises RigError if ROS 2 is not there."""
        signals = load_signals(plan.path(self.signals) if self.signals else None)
        try:
            node_module = import_module(TOPIC_RIG)
        except ModuleNotFoundError as error:
            raise RigError(f"{where}: kind is ros, but {error.name} is missing; source ROS 2 first") from None
        rig: RigAdapter = node_module.TopicRig(self, signals)
        return rig


RIG = Field(kind=OneOf({"virtual": VirtualRigSettings, "folder": FolderRigSettings, "ros": RosRigSettings}))


def open_rig(plan: Plan) -> RigAdapter:
    """Return the plan's rig; raises a CesError that names the key at fault."""
    where = f"{plan.source}: rig"
    rig: RigAdapter = RIG.check(plan.rig, where, RigError).open(plan, where)
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
        self._keep = max(1, round(LiveLimits.FOLLOW_S * settings.rate_hz))

    def check(self, time_s: float, set_point_m: float, newest: tuple[float, float] | None) -> None:
        """Take the set point of `time_s` and the newest position as (time, stroke); raises RigError."""
        self._recent = [*self._recent[-self._keep :], set_point_m]
        heard_s = newest[0] if newest else self._begin_s
        silent = time_s - heard_s
        if silent > self._settings.silence_s and time_s - self._begin_s > LiveLimits.GRACE_S:
            raise RigError(f"{self._name}: no position for {silent:.2f} s; the run was broken off, check the rig")
        if newest is None:
            return
        low, high = min(self._recent), max(self._recent)
        distance = max(low - newest[1], newest[1] - high, 0.0)
        if distance > self._settings.deviation_m:
            raise RigError(
                f"{self._name}: the stroke is {1e3 * distance:.1f} mm from its set points, rig: deviation_m allows "
                f"{1e3 * self._settings.deviation_m:g} mm; the run was broken off, check the rig and its zero"
            )
