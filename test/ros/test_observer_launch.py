"""The launch file as a user starts it: two observers in two namespaces, each with its parameters, to Ctrl-C."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

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
from replay import currents, jittered_positions, offline, require_equal
from vehicle import Vehicle

MS = 1_000_000
STAMPED_CURRENT = {"topic": "stamped_current", "type": "sensor_msgs/msg/Temperature", "field": "temperature"}
RELIABLE = {"reliability": "reliable", "depth": 5000}


class Launched:
    """Two vehicles, the model file of the first, and the exits of the processes launched for them."""

    def __init__(self, replayed: Vehicle, driven: Vehicle, model_path: Path) -> None:
        self.replayed, self.driven, self.model_path = replayed, driven, model_path
        self.exits: list[ProcessExited] = []


@pytest.fixture(scope="module")
def launched(laid_out: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Launched]:
    path = tmp_path_factory.mktemp("launched") / "model.json"
    plain_damper(max_gap_s=0.3).save(path)
    with pytest.MonkeyPatch.context() as patch, Vehicle(new_namespace()) as one, Vehicle(new_namespace()) as other:
        for name, value in laid_out.items():
            patch.setitem(os.environ, name, value)
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
    samples = [(stamp, vehicle.publish_position, value) for stamp, value in positions]
    samples += [(stamp, vehicle.publish_current, value) for stamp, value in held]
    for stamp, publish, value in sorted(samples, key=lambda sample: sample[0]):
        publish(stamp, value)
    require_equal(vehicle, offline(positions, held))


@pytest.mark.launch(fixture=observers, shutdown=True)
def test_ctrl_c_ends_both_with_status_0(launched: Launched) -> None:
    assert [exit.returncode for exit in launched.exits] == [0, 0]
