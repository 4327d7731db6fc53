"""A vehicle's launch file that includes the observer's twice, in two namespaces, one with other topics and managed."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from conftest import new_namespace
from node_process import NodeProcess, ros_args
from patience import PATIENCE_S
from replay import Offline, currents, jittered_positions, require_equal
from vehicle import Vehicle, wait

from ces_cli.main import PROGRAMS

STAMPED_CURRENT = {"type": "sensor_msgs/msg/Temperature", "field": "temperature"}
RELIABLE = {"subscription": {"reliability": "reliable", "depth": 5000}}
VEHICLE = """
from launch import LaunchDescription
from launch.actions import GroupAction, IncludeLaunchDescription
from launch_ros.actions import LifecycleTransition, PushRosNamespace, SetRemap
from launch_ros.substitutions import FindPackageShare


def observer(**arguments):
    file = [FindPackageShare("ces_observer"), "/launch/observer.launch.py"]
    return IncludeLaunchDescription(file, launch_arguments={"log_level": "warn", **arguments}.items())


def generate_launch_description():
    replayed = observer(**REPLAYED, current_topic="stamped_current")
    topics = {"position_topic": "damper/stroke", "estimate_topic": "damper/force"}
    driven = observer(**DRIVEN, **topics, autostart="false")
    moved = [PushRosNamespace(NAMESPACE), SetRemap("damper/stroke", "joint_states"), driven]
    managed = LifecycleTransition(lifecycle_node_names=[f"{NAMESPACE}/observer"], transition_ids=[1, 3])
    return LaunchDescription([GroupAction([replayed]), GroupAction(moved), managed])
"""


class Launched:
    """Two vehicles, one to replay samples to and one to drive, and the launch of an observer for each of them."""

    def __init__(self, replayed: Vehicle, driven: Vehicle, model: Path, env: dict[str, str], folder: Path) -> None:
        self.replayed, self.driven = replayed, driven
        self.forces = driven.hear_estimates("damper/force")
        inputs = ("joint_states", "stamped_current")
        reliable = {f"{replayed.namespace}/{topic}": RELIABLE for topic in inputs}
        ours = {"max_age_s": 0.0, "wait_for_current_s": 10.0, "current": STAMPED_CURRENT, "qos_overrides": reliable}
        other = {"name": "driven", "qos_overrides": {f"{driven.namespace}/joint_states": RELIABLE}}
        given = {
            "REPLAYED": {**arguments(folder / "replayed.yaml", model, ours), "namespace": replayed.namespace},
            "DRIVEN": arguments(folder / "driven.yaml", model, other),
            "NAMESPACE": driven.namespace,
        }
        file = folder / "vehicle.launch.py"
        file.write_text(VEHICLE + "\n".join(f"{name} = {value!r}" for name, value in given.items()), encoding="utf-8")
        self.process = NodeProcess(["ros2", "launch", str(file)], env)


@pytest.fixture(scope="module")
def launched(
    laid_out: dict[str, str], model_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Launched]:
    with Vehicle(new_namespace()) as one, Vehicle(new_namespace()) as other:
        made = Launched(one, other, model_path, laid_out, tmp_path_factory.mktemp("launched"))
        yield made
        made.process.kill()


def arguments(file: Path, model: Path, parameters: dict[str, object]) -> dict[str, str]:
    """Write a parameter file; return the launch arguments with which an observer reads it."""
    file.write_text(json.dumps({"/**": {"ros__parameters": parameters}}), encoding="utf-8")  # YAML, too
    return {"params_file": str(file), "model": str(model)}


def test_both_nodes_start_with_their_topics_and_do_not_mix(launched: Launched) -> None:
    launched.replayed.meets_node()
    launched.driven.meets_node("damper/force")
    launched.driven.meets_node("damper/force_band")
    launched.driven.drive_until(lambda: len(launched.forces) > 100, "estimates")
    assert {name for message in launched.forces for name in message.name} == {"driven"}
    assert not launched.replayed.estimates
    assert not launched.driven.estimates


def test_estimates_equal_the_offline_replay(launched: Launched) -> None:
    vehicle, positions, held = launched.replayed, jittered_positions(2000), currents(2000)
    vehicle.publish_burst(positions, held, is_in_order=True)
    require_equal(vehicle, Offline().take(positions, held))


def test_ctrl_c_ends_both_in_order(launched: Launched) -> None:
    launched.process.interrupt()
    status, output = launched.process.ended()
    assert status == 0, output
    assert output.count("process has finished cleanly") == 2, output


PREFIX = "AMENT_PREFIX_PATH"


@pytest.fixture
def launched_inst(installed: dict[str, str], namespace: str, model_path: Path) -> Iterator[tuple[NodeProcess, Vehicle]]:
    words = ["ros2", "launch", "ces_observer", "observer.launch.py", f"model:={model_path}", f"namespace:={namespace}"]
    process = NodeProcess(words, installed)
    with Vehicle(namespace) as vehicle:
        yield process, vehicle
    process.kill()


def test_ros2_run_finds_the_node_and_every_program(installed: dict[str, str]) -> None:
    done = run(["ros2", "pkg", "executables", "ces_observer"], installed)
    assert {line.split()[1] for line in done.stdout.splitlines()} == {"observer", "controller", *PROGRAMS}


def test_share_holds_manifest_launch_file_and_parameters(installed: dict[str, str]) -> None:
    share = Path(installed[PREFIX].split(":")[0]) / "share"
    found = {str(path.relative_to(share / "ces_observer")) for path in (share / "ces_observer").rglob("*")}
    assert {"package.xml", "launch/observer.launch.py", "config/observer.yaml", "config/identify.yaml"} <= found
    assert {"config/plotjuggler.xml", "config/foxglove.json", "config/signals.yaml"} <= found
    assert (share / "ament_index/resource_index/packages/ces_observer").exists()


def test_launch_file_starts_the_node_with_the_shipped_parameters(launched_inst: tuple[NodeProcess, Vehicle]) -> None:
    process, vehicle = launched_inst
    vehicle.meets_node()
    with vehicle.driving():
        wait(lambda: bool(vehicle.estimates), "an estimate")
    process.interrupt()
    status, output = process.ended()
    assert status == 0, output
    assert "process has finished cleanly" in output


def test_ros2_run_gives_the_exit_status(installed: dict[str, str], namespace: str) -> None:
    done = run(["ros2", "run", "ces_observer", "observer", *ros_args(namespace, {"model": "/nowhere.json"})], installed)
    assert done.returncode == 2
    assert "/nowhere.json: no such model file" in done.stderr


def run(command: list[str], env: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, env=env, capture_output=True, text=True, check=False, timeout=PATIENCE_S)
