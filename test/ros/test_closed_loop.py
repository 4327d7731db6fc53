"""The launch file closed_loop.launch.py as a user starts it: the force follows its curve, Ctrl-C ends all nodes."""

from __future__ import annotations

import os
import shutil
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from node_process import ROOT, NodeProcess
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from vehicle import stamp_of, wait

MODULES = {
    "rig": "ces_rig.live.node",
    "observer": "ces_observer.nodes.observer",
    "controller": "ces_observer.nodes.controller",
}
DEEP = QoSProfile(depth=50_000)
START_S = 60.0  # the rig's kernels may have to be compiled first
RUN = 3500  # forces to be heard, one every millisecond of the rig's time
SETTLED_NS = 1.5e9
MOST_ERROR = 0.21  # 0.18 as a rule; 0.22 without feedback, 0.27 at a constant current
FELT_N = 300.0  # desired forces below are those of reversals, when the valve has no say


@pytest.fixture
def prefix(tmp_path: Path) -> dict[str, str]:
    """Lay this checkout out as if it were installed, so that the kernels compiled for it are used."""
    share, programs = tmp_path / "share", tmp_path / "lib" / "ces_observer"
    index = share / "ament_index" / "resource_index" / "packages"
    for folder in (index, share / "ces_observer", programs):
        folder.mkdir(parents=True)
    (index / "ces_observer").touch()
    for name in ("launch", "config"):
        shutil.copytree(ROOT / name, share / "ces_observer" / name)
    for name, module in MODULES.items():
        program = programs / name
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m {module} "$@"\n', encoding="utf-8")
        program.chmod(0o755)
    return {"AMENT_PREFIX_PATH": f"{tmp_path}:{os.environ['AMENT_PREFIX_PATH']}", "ROS_LOG_DIR": str(tmp_path / "log")}


class Ears:
    """What is heard of a closed loop, by stamp [ns]."""

    def __init__(self, namespace: str) -> None:
        self._context = rclpy.Context()
        self._context.init()
        self._node = rclpy.create_node("ears", namespace=namespace, context=self._context)
        self.desired_N: dict[int, float] = {}
        self.measured_N: dict[int, float] = {}
        self.told: list[str] = []
        hear = self._node.create_subscription
        hear(WrenchStamped, "controller/desired_force", lambda m: self._put(self.desired_N, m), DEEP)
        hear(WrenchStamped, "measured_force", lambda m: self._put(self.measured_N, m), DEEP)
        hear(DiagnosticArray, "/diagnostics", self._hear_diagnostics, 100)
        self._name = f"{namespace}/controller: damper"
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._executor.shutdown()
        self._thread.join()
        self._node.destroy_node()
        self._context.shutdown()

    def _put(self, forces: dict[int, float], message: WrenchStamped) -> None:
        forces[stamp_of(message)] = message.wrench.force.z

    def _hear_diagnostics(self, message: DiagnosticArray) -> None:
        self.told.extend(status.message for status in message.status if status.name == self._name)


@pytest.fixture
def ears(namespace: str) -> Iterator[Ears]:
    made = Ears(namespace)
    yield made
    made.close()


def test_the_force_follows_its_curve_and_ctrl_c_ends_all(prefix: dict[str, str], ears: Ears, namespace: str) -> None:
    """At half of real time, for computers that are busy with other tests."""
    words = [f"namespace:={namespace}", "use_sim_time:=true", "real_time_factor:=0.5"]
    process = NodeProcess(["ros2", "launch", "ces_observer", "closed_loop.launch.py", *words], prefix)
    try:
        wait(lambda: len(ears.desired_N) >= RUN or not process.is_running(), "forces to follow", START_S)
        assert "controlling" in ears.told
        assert tracking_error(ears) < MOST_ERROR
    finally:
        process.interrupt()
        status, output = process.ended(30.0)
    assert status == 0, output
    assert output.count("process has finished cleanly") == len(MODULES), output
    assert "Traceback" not in output


def tracking_error(ears: Ears) -> float:
    """Return the RMS of measured less desired force over that of the desired one, where both are known and felt."""
    stamps = sorted(ears.desired_N.keys() & ears.measured_N.keys())
    settled = [stamp for stamp in stamps if stamp > stamps[0] + SETTLED_NS]
    desired, measured = (np.array([forces[s] for s in settled]) for forces in (ears.desired_N, ears.measured_N))
    felt = np.abs(desired) > FELT_N
    assert felt.sum() > 500
    return float(np.sqrt(np.mean((measured - desired)[felt] ** 2) / np.mean(desired[felt] ** 2)))
