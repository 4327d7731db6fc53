"""What colcon installs: the programs ros2 run finds, the launch file, parameters and manifest; built in a new place."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from node_process import NodeProcess, ros_args
from patience import PATIENCE_S
from vehicle import Vehicle, wait

from ces_cli.main import PROGRAMS

PREFIX = "AMENT_PREFIX_PATH"


@pytest.fixture
def launched(installed: dict[str, str], namespace: str, model_path: Path) -> Iterator[tuple[NodeProcess, Vehicle]]:
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


def test_launch_file_starts_the_node_with_the_shipped_parameters(launched: tuple[NodeProcess, Vehicle]) -> None:
    process, vehicle = launched
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
