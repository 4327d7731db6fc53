"""Mistakes in what the observer node is given at its start: one FATAL line that says what to do, and exit status 2."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

import rclpy
from conftest import new_namespace
from node_process import NodeProcess, ros_args
from parameter_cases import AT_START, wrong_type
from party import require_answers
from vehicle import Vehicle

from ces_observer.nodes.executors import START_ERRORS
from ces_observer.nodes.observer import Observer
from ces_observer.nodes.parameters import TableNode, declare_observer, read_dampers

MISTAKES: dict[str, dict[str, object]] = {
    "expected a finite number": {"model": "nan.json"},
    "not proved to be a contraction": {"model": "unstable.json"},
    "no such model file": {"model": "/nowhere/model.json"},
    "parameter 'model' is not set": {"model": "''"},
    "message type 'sensor_msgs/msg/JoinState' is not installed": {"position.type": "sensor_msgs/msg/JoinState"},
    "no 'pos'; known are header, name, position": {"position.field": "pos[rear_damper]"},
    "'data' is not an array": {"current.field": "data[0]"},
    "is a Header; expected the path to a number": {"position.field": "header"},
    "unknown key 'feild'": {"position.feild": "data"},
    "scale is 0": {"position.scale": 0.0},
    "'model' is 'model.json'; expected the absolute path": {"model": "model.json"},
    "'model' is '~nobody_here/model.json'; expected the absolute path": {"model": "~nobody_here/model.json"},
    **{words: {name: text} for words, (name, _, text) in AT_START.items()},
    "parameter 'executor' is 'many'; expected one of auto, events, single": {"executor": "many"},
    "'no topic' is not a topic name": {"position.topic": "no topic"},
    wrong_type("dampers", "string_array", "string"): {"dampers": "front"},
    "'dampers' has 'front damper'; expected letters": {"dampers": "['front damper']"},
    "expected each name once": {"dampers": "[front, front]"},
    wrong_type("rear.max_age_s", "double", "string"): {"dampers": "[rear]", "rear.max_age_s": "soon"},
    "'rear.max_age_s' is -1.0; expected a number from": {"dampers": "[rear]", "rear.max_age_s": -1.0},
    "rear.json: no such model file": {"dampers": "[rear]", "rear.model": "/nowhere/rear.json"},
    "signal 'rear.position' is constant": {"dampers": "[rear]", "rear.position.constant": 0.0},
    "has no value or is an empty list": {"dampers": "[]"},
}
BROKEN = {"nan.json": "NaN", "unstable.json": "1.01"}  # coefficient of the past force


def given(mistake: dict[str, object], model_path: Path, folder: Path) -> dict[str, object]:
    """Return the parameters with this mistake; a broken model is written to the folder."""
    if mistake.get("model") not in BROKEN:
        return {"model": model_path, **mistake}
    path = folder / str(mistake["model"])
    number = BROKEN[path.name]
    path.write_text(model_path.read_text().replace('"coefficient": 0.9', f'"coefficient": {number}'))
    return {"model": path}


@pytest.mark.parametrize("line", MISTAKES)
def test_every_mistake_is_refused_while_the_node_is_built(line: str, model_path: Path, tmp_path: Path) -> None:
    """In this process, which is quicker than a node."""
    rclpy.init(args=ros_args(new_namespace(), given(MISTAKES[line], model_path, tmp_path)))
    try:
        with pytest.raises(START_ERRORS, match=re.escape(line)):
            Observer().start()
    finally:
        rclpy.shutdown()


@pytest.mark.parametrize("line", ["expected a finite number", "max_age_s' is -1.0", "has no value"])
def test_a_mistake_at_start_is_one_fatal_line_and_status_2(line: str, model_path: Path, tmp_path: Path) -> None:
    """A model, a number and a list without type that are wrong: the three ways in which a node is not built."""
    mistake = next(one for text, one in MISTAKES.items() if line in text)
    status, output = NodeProcess.from_source(new_namespace(), given(mistake, model_path, tmp_path)).ended()
    fatal = [text for text in output.splitlines() if "[WARN]" not in text]
    assert status == 2, output
    assert len(fatal) == 1, output
    assert "[FATAL]" in fatal[0] and line in fatal[0]


def test_parameters_that_are_not_set_may_be_null(model_path: Path) -> None:
    """As `ros2 param dump` writes them, so that the node starts with the file."""
    unset = ("dampers", "current.constant", "acceleration.topic", "acceleration.scale", "speed.field")
    dumped = {"model": model_path, "max_age_s": 0.2, **dict.fromkeys(unset, "null")}
    rclpy.init(args=ros_args("/dumped", dumped))
    try:
        node = TableNode("observer")
        (damper,) = read_dampers(node, declare_observer(node)[1])
    finally:
        rclpy.shutdown()
    assert damper.key == ""
    assert damper.values["max_age_s"] == 0.2
    assert set(damper.signals.by_name) == {"position", "current", "force"}


def test_a_running_node_refuses_in_the_words_of_both_nodes(vehicle: Vehicle, start: Callable[..., NodeProcess]) -> None:
    """A value that only one damper has, too."""
    start(dampers="[front]", **{"front.max_age_s": 0.2})
    require_answers(vehicle, "observer")
    assert vehicle.sets("front.max_age_s", -1.0).reason.startswith("parameter 'front.max_age_s' is -1.0; expected a")
    assert vehicle.sets("front.max_age_s", "soon").reason == wrong_type("front.max_age_s", "double", "string")
    assert vehicle.sets("model", "model.json").reason.startswith("parameter 'model' is 'model.json'; expected the abs")
