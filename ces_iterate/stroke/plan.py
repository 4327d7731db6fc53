"""The plan of a learning (YAML): the wanted stroke, the rig, its limits and how to learn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ces_identify.config_file import read_yaml_mapping
from ces_iterate.stroke.actuator_model import ActuatorModel
from ces_iterate.stroke.errors import StrokeError
from ces_iterate.stroke.goal import LearningSettings, ProbeSettings, StrokeGoal
from ces_iterate.stroke.limits import StrokeLimits
from ces_iterate.stroke.rig import INTERVAL_S
from ces_rig.descriptions import build
from ces_rig.drive.servo_actuator import ServoActuator
from ces_rig.errors import RigError
from ces_rig.experiment import STREAMS, Experiment, find_experiment, load_experiment, packaged_experiments, with_seed

KEYS = ("description", "experiment", "actuator", "limits", "probe", "learning", "model")
WHAT = "a plan of a stroke to learn"


@dataclass(frozen=True)
class StrokePlan:
    """A goal, and the experiment on the virtual rig that it belongs to, with the path of its file."""

    goal: StrokeGoal
    experiment: Experiment
    experiment_path: Path

    @property
    def identity(self) -> str:
        """Everything besides the command that a run depends on, as text."""
        e = self.experiment
        return repr((e.settings, e.current, e.damper, e.sensors, e.actuator))


def load_plan(path: Path, seed: int | None = None) -> StrokePlan:
    """Return the plan in a YAML file, `seed` replacing its experiment's; raises StrokeError or RigError."""
    content = read_yaml_mapping(path, WHAT, KEYS, StrokeError)
    if not isinstance(content.get("experiment"), str):
        raise StrokeError(f"{path}: 'experiment' is {content.get('experiment')!r}; expected a packaged name or a file")
    file = _find_experiment(content["experiment"], path.parent)
    experiment = load_experiment(file)
    if "actuator" in content:
        experiment = replace(experiment, actuator=build(ServoActuator, content["actuator"], f"{path}: actuator"))
    experiment = experiment if seed is None else with_seed(experiment, seed)
    return StrokePlan(_read_goal(content, experiment, path), experiment, file)


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
        "actuator": vars(plan.experiment.actuator),
    }
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


def _find_experiment(name: str, folder: Path) -> Path:
    """Return the file beside the plan, or the packaged experiment, of this name."""
    return folder / name if name not in packaged_experiments() and (folder / name).is_file() else find_experiment(name)


def _read_goal(content: Mapping[str, Any], experiment: Experiment, path: Path) -> StrokeGoal:
    settings = experiment.settings
    time = np.arange(round(settings.duration_s / INTERVAL_S) + 1, dtype=np.float64) * INTERVAL_S
    wanted = experiment.stroke.samples(time, np.random.default_rng([settings.seed, STREAMS["stroke"]]))
    model = content.get("model")
    return StrokeGoal(
        wanted,
        INTERVAL_S,
        build(StrokeLimits, content.get("limits", {}), f"{path}: limits"),
        build(LearningSettings, content.get("learning", {}), f"{path}: learning"),
        build(ProbeSettings, content.get("probe", {}), f"{path}: probe"),
        None if model is None else build(ActuatorModel, model, f"{path}: model"),
    )
