"""The launch file as a user starts it: two observers in two namespaces, through faults and changes, to Ctrl-C."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any

import pytest

from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.terms import Term

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")
pytest.importorskip("launch_pytest", reason="launch_pytest is not installed")

import launch_pytest
from conftest import ROOT, new_namespace
from damper_models import plain_damper
from launch import LaunchDescription
from launch.actions import GroupAction, IncludeLaunchDescription, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events.process import ProcessExited
from launch_pytest.actions import ReadyToTest
from replay import currents, jittered_positions, offline
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from vehicle import DEEP, Vehicle, wait

MS = 1_000_000
STAMPED_CURRENT = {"topic": "stamped_current", "type": "sensor_msgs/msg/Temperature", "field": "temperature"}
RELIABLE = {"reliability": "reliable", "depth": 5000}


class Launched:
    """Two vehicles, the model file of the first, and the exits of the processes launched for them."""

    def __init__(self, replayed: Vehicle, driven: Vehicle, model_path: Path) -> None:
        self.replayed, self.driven, self.model_path = replayed, driven, model_path
        self.exits: list[ProcessExited] = []


@pytest.fixture(scope="module")
def launched(installed: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Launched]:
    path = tmp_path_factory.mktemp("launched") / "model.json"
    plain_damper(max_gap_s=0.3).save(path)
    with pytest.MonkeyPatch.context() as patch, Vehicle(new_namespace()) as one, Vehicle(new_namespace()) as other:
        for name in ("AMENT_PREFIX_PATH", "PATH", "PYTHONPATH"):
            patch.setitem(os.environ, name, installed[name])
        yield Launched(one, other, path)


@launch_pytest.fixture(scope="module")
def observers(launched: Launched, tmp_path_factory: pytest.TempPathFactory) -> LaunchDescription:
    """Describe the launch of an observer for each of the vehicles, with a parameter file of their own."""
    inputs = ("joint_states", "stamped_current")
    reliable = {f"{launched.replayed.namespace}/{topic}": {"subscription": RELIABLE} for topic in inputs}
    replayed = {"max_age_s": 0.0, "wait_for_current_s": 10.0, "current": STAMPED_CURRENT, "qos_overrides": reliable}
    joints = f"{launched.driven.namespace}/joint_states"
    driven = {"name": "driven", "qos_overrides": {joints: {"subscription": RELIABLE}}}
    folder = tmp_path_factory.mktemp("parameters")
    return LaunchDescription(
        [
            RegisterEventHandler(OnProcessExit(on_exit=lambda event, context: launched.exits.append(event))),
            observer(launched.replayed, launched.model_path, parameter_file(folder / "replayed.yaml", replayed)),
            observer(launched.driven, launched.model_path, parameter_file(folder / "driven.yaml", driven)),
            ReadyToTest(),
        ]
    )


def parameter_file(path: Path, parameters: dict[str, object]) -> Path:
    path.write_text(json.dumps({"/**": {"ros__parameters": {**parameters}}}))  # YAML, too
    return path


def observer(vehicle: Vehicle, model: Path, parameters: Path) -> GroupAction:
    arguments = {"model": model, "params_file": parameters, "namespace": vehicle.namespace, "log_level": "warn"}
    given = [(name, str(value)) for name, value in arguments.items()]
    return GroupAction([IncludeLaunchDescription(str(ROOT / "launch/observer.launch.py"), launch_arguments=given)])


in_launch: Callable[..., pytest.MarkDecorator] = pytest.mark.launch(fixture=observers)


@in_launch
def test_both_nodes_start_and_do_not_mix(launched: Launched) -> None:
    launched.replayed.meets_node()
    launched.driven.meets_node()
    launched.driven.drive_until(lambda: len(launched.driven.estimates) > 100, "estimates")
    assert {name for message in launched.driven.estimates for name in message.name} == {"driven"}
    assert not launched.replayed.estimates


@in_launch
def test_estimates_equal_the_offline_replay(launched: Launched) -> None:
    vehicle, positions, held = launched.replayed, jittered_positions(2000), currents(2000)
    expected = offline(positions, held)
    samples = [(stamp, vehicle.publish_position, value) for stamp, value in positions]
    samples += [(stamp, vehicle.publish_current, value) for stamp, value in held]
    for stamp, publish, value in sorted(samples, key=lambda sample: sample[0]):
        publish(stamp, value)
    wait(lambda: len(vehicle.estimates) >= len(expected), "all estimates")
    assert vehicle.stamps() == list(expected)
    for message, numbers in zip(vehicle.estimates, expected.values(), strict=True):
        found = (message.position[0], message.velocity[0], message.effort[0])
        assert found == pytest.approx(numbers, rel=1e-9)


@in_launch
def test_withholds_says_why_and_recovers(launched: Launched) -> None:
    recovers_after(launched.driven, "not finite", position=lambda time_s: nan)


@in_launch
def test_time_that_jumps_is_lived_through(launched: Launched) -> None:
    recovers_after(launched.driven, "ahead of it, max_age_s", clock_offset_s=60.0)


@in_launch
def test_publishers_that_are_lost_and_come_back(launched: Launched) -> None:
    vehicle = launched.driven
    vehicle.drive(0.3)
    before = len(vehicle.statuses)
    vehicle.node.destroy_publisher(vehicle.position)
    vehicle.node.destroy_publisher(vehicle.current)
    vehicle.hears("nothing publishes", None, before)
    vehicle.position = vehicle.node.create_publisher(JointState, "joint_states", DEEP)
    vehicle.current = vehicle.node.create_publisher(Float64, "valve_current", DEEP)
    vehicle.meets_node()
    vehicle.recover(0.3)


def recovers_after(vehicle: Vehicle, told: str, **fault: Any) -> None:
    vehicle.drive(0.3)
    before = len(vehicle.statuses)
    with vehicle.driving(**fault):
        vehicle.hears(told, None, before)
    vehicle.recover(0.3)


@in_launch
def test_a_parameter_changes_live_and_a_wrong_one_is_refused(launched: Launched) -> None:
    assert not launched.driven.sets("max_age_s", -1.0).successful
    assert launched.driven.sets("max_age_s", 0.4).successful
    assert launched.driven.gets("max_age_s") == 0.4


@in_launch
def test_the_model_is_reloaded_without_a_gap(launched: Launched) -> None:
    vehicle, model = launched.driven, plain_damper(max_gap_s=0.3)
    first, *others = model.body.terms
    assert vehicle.sets("max_age_s", 0.0).successful  # samples that a busy computer holds up are no gap
    softer = replace(model, body=Polynomial((Term(0.8, first.factors), *others)))
    with vehicle.driving(contiguous=True):
        begun = time.time_ns()
        wait(lambda: vehicle.stamps()[-1] > begun + 300 * MS, "estimates again")
        begins = vehicle.stamps()[-1]
        softer.save(launched.model_path)
        answer = vehicle.reloads.call()
        assert answer.success, answer.message
        vehicle.hears_value("model sha256", softer.digest())
    ends = vehicle.driven[-1] - 100 * MS
    wait(lambda: vehicle.stamps()[-1] >= ends, "the last estimates")
    assert [s for s in vehicle.stamps() if begins <= s <= ends] == [s for s in vehicle.driven if begins <= s <= ends]


@pytest.mark.launch(fixture=observers, shutdown=True)
def test_ctrl_c_ends_both_with_status_0(launched: Launched) -> None:
    assert [exit.returncode for exit in launched.exits] == [0, 0]
