"""The plan of a learning (YAML): the wanted stroke, the rig, its limits and how to learn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ces_data.config_file import read_yaml_mapping
from ces_identify.schema_files import schema_line
from ces_iterate.commands import INTERVAL_S
from ces_iterate.errors import StrokeError
from ces_iterate.plan import Plan, RigLimits
from ces_iterate.rigs.kinds import RIG_SETTINGS, open_rig
from ces_iterate.stroke.actuator import ActuatorModel
from ces_iterate.stroke.learning import LearningSettings, ProbeSettings, StrokeGoal
from ces_iterate.stroke.limits import StrokeLimits
from ces_iterate.stroke.rigs import CommandedRig, StrokeRig, VirtualStrokeRig
from ces_observer.fields import read_record
from ces_rig.drive.servo_actuator import ServoActuator
from ces_rig.errors import RigError
from ces_rig.experiment import Experiment, find_experiment, load_experiment, packaged_experiments, with_seed
from ces_rig.sensors import STREAMS

KEYS = ("description", "experiment", "rig", "actuator", "limits", "probe", "learning", "model")
VIRTUAL = "virtual"
WHAT = "a plan of a stroke to learn"
ROOM = 0.01  # of the limits, for peaks between the samples of a command, which its differences do not show


@dataclass(frozen=True)
class StrokePlan:
    """A goal, and the experiment on the virtual rig that it belongs to, with the path of its file."""

    goal: StrokeGoal
    experiment: Experiment
    experiment_path: Path
    source: Path
    rig: Mapping[str, Any]

    def open_rig(self, folder: Path) -> StrokeRig:
        """Return the rig of the plan, which may keep files in `folder`; raises CesError naming the key at fault."""
        if self.rig.get("kind") == VIRTUAL:
            return VirtualStrokeRig(self.experiment)
        stroke, speed, acceleration = (limit * (1.0 + ROOM) for limit in self.goal.limits.as_tuple())
        valve = self.experiment.damper.ces_valve
        allowed = RigLimits(stroke, speed, acceleration, valve.allowed_low_A, valve.allowed_high_A)
        plan = Plan(limits=allowed, source=str(self.source), folder=self.source.parent, rig=self.rig)
        rig = open_rig(plan)
        return CommandedRig(rig, self.experiment, allowed, folder)


def load_plan(path: Path, seed: int | None = None) -> StrokePlan:
    """Return the plan in a YAML file, with another `seed` if given; raises IterateError, of the experiment RigError."""
    content = read_yaml_mapping(path, WHAT, KEYS, StrokeError)
    if not isinstance(content.get("experiment"), str):
        raise StrokeError(f"{path}: 'experiment' is {content.get('experiment')!r}; expected a packaged name or a file")
    name, beside = content["experiment"], path.parent / content["experiment"]
    file = beside if name not in packaged_experiments() and beside.is_file() else find_experiment(name)
    experiment = load_experiment(file)
    if "actuator" in content:
        actuator = read_record(ServoActuator, content["actuator"], f"{path}: actuator", StrokeError)
        experiment = replace(experiment, actuator=actuator)
    experiment = experiment if seed is None else with_seed(experiment, seed)
    rig = content.get("rig", {"kind": VIRTUAL})
    if not isinstance(rig, Mapping) or rig.get("kind") not in RIG_SETTINGS:
        raise StrokeError(f"{path}: rig is {rig!r}; expected a mapping with kind: one of {', '.join(RIG_SETTINGS)}")
    settings = experiment.settings
    time = np.arange(round(settings.duration_s / INTERVAL_S) + 1, dtype=np.float64) * INTERVAL_S
    model = content.get("model")
    goal = StrokeGoal(
        experiment.stroke.samples(time, np.random.default_rng([settings.seed, STREAMS["stroke"]])),
        INTERVAL_S,
        read_record(StrokeLimits, content.get("limits", {}), f"{path}: limits", StrokeError),
        read_record(LearningSettings, content.get("learning", {}), f"{path}: learning", StrokeError),
        read_record(ProbeSettings, content.get("probe", {}), f"{path}: probe", StrokeError),
        None if model is None else read_record(ActuatorModel, model, f"{path}: model", StrokeError),
    )
    return StrokePlan(goal, experiment, file, path, rig)


def write_learned_experiment(plan: StrokePlan, command_file: str) -> str:
    """Return the YAML of an experiment that runs the learned command on the virtual rig."""
    content = read_yaml_mapping(plan.experiment_path, "an experiment", error=RigError)
    if isinstance(content.get("damper"), str):
        content["damper"] = str((plan.experiment_path.parent / content["damper"]).resolve())
    settings = plan.experiment.settings
    content |= {
        "description": f"learned command of {settings.name}",
        "duration_s": float(plan.goal.interval_s * (len(plan.goal.wanted_m) - 1)),
        "seed": settings.seed,
        "stroke": {"kind": "file", "path": command_file, "fade_s": 0.0},
    }
    if plan.experiment.actuator is not None:
        content["actuator"] = vars(plan.experiment.actuator)
    return schema_line("experiment") + yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
