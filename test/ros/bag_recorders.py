"""`ros2 bag record` and `ros2 bag play` as processes, and the experiment that is recorded with them."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from node_process import ROOT, NodeProcess
from party import Party
from patience import PATIENCE_S
from rclpy.duration import Duration
from sensor_msgs.msg import JointState, Temperature
from vehicle import DEEP, JOINT, Vehicle, stamp_of, stroke, wait

from ces_data.bags.reader import read_recording
from ces_observer.signals import Signals

TOPICS = {"position": "joint_states", "current": "stamped_current", "force": "measured_force"}
TYPES = {"position": JointState, "current": Temperature, "force": WrenchStamped}
MS = 1_000_000
ENDS_S = 120.0  # for a recorder to store the last messages
LOSSLESS = {"reliability": "reliable", "history": "keep_all"}  # the recorder or player is slowed down instead
KEEP_ALL = "{history: keep_all, reliability: reliable, durability: volatile}"


# A mark, not a skip while the module is imported: that would reach launch_testing's collector and skip all tests.
NEEDS_ROSBAG2 = pytest.mark.skipif(
    shutil.which("ros2") is None or find_spec("ros2bag") is None or find_spec("rosbag2_py") is None,
    reason="rosbag2 is not installed",
)


def described_signals(namespace: str) -> Signals:
    """Return the signals of the experiment in a namespace."""
    return Signals.from_mapping(signals_mapping(namespace), "experiment")


def signals_mapping(namespace: str) -> dict[str, dict[str, str]]:
    """Return what a signals file says of the experiment's topics."""
    mapping: dict[str, dict[str, str]] = {name: {"topic": f"{namespace}/{topic}"} for name, topic in TOPICS.items()}
    mapping["current"] |= {"type": "sensor_msgs/msg/Temperature", "field": "temperature"}
    return mapping


class Experiment(Party):
    """Publishes position, current and force, 1 kHz each, with stamps a millisecond apart."""

    def __init__(self, namespace: str) -> None:
        super().__init__("experiment", namespace)
        self.topics = [f"{namespace}/{topic}" for topic in TOPICS.values()]
        self._publishers = {
            name: self.node.create_publisher(TYPES[name], topic, DEEP) for name, topic in TOPICS.items()
        }
        self.published: dict[str, dict[int, float]] = {name: {} for name in TOPICS}  # values by stamp [ns]

    def meets(self, recorders: Collection[Recorder]) -> None:
        """Wait until the recorders hear every topic; fails at once if one has ended."""
        for name, publisher in self._publishers.items():

            def met(publisher: Any = publisher) -> bool:
                for recorder in recorders:
                    recorder.require_running()
                return bool(publisher.get_subscription_count() >= len(recorders))

            wait(met, f"{len(recorders)} recorders of {name}")
        time.sleep(0.5)  # matching is told to each side on its own

    def run(self, duration_s: float) -> None:
        """Publish for `duration_s`."""
        start, start_ns = time.monotonic(), time.time_ns()
        for k in range(round(duration_s * 1000)):
            time.sleep(max(0.0, start + k * 1e-3 - time.monotonic()))
            self._publish(start_ns + k * MS, k)
        for publisher in self._publishers.values():
            assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE_S))
        time.sleep(0.5)  # the recorders take what they have received

    def _publish(self, stamp_ns: int, k: int) -> None:
        values = {"position": stroke(k * 1e-3), "current": 0.5 + 0.2 * np.sin(k * 0.01), "force": 10.0 + k}
        messages = {
            "position": JointState(name=["steering", JOINT], position=[1.0, values["position"]]),
            "current": Temperature(temperature=values["current"]),
            "force": WrenchStamped(),
        }
        messages["force"].wrench.force.z = values["force"]
        for name, message in messages.items():
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
            self._publishers[name].publish(message)
            self.published[name][stamp_ns] = values[name]


class Recorder:
    """`ros2 bag record` of some topics into the folder `path`."""

    def __init__(self, path: Path, topics: Sequence[str], options: Iterable[str]) -> None:
        self.path = path
        words = ["ros2", "bag", "record", "-o", str(path), *keep_all(path, topics)]
        self._process = NodeProcess([*words, *options, *topics])

    def ends(self, number: signal.Signals) -> None:
        """End the recorder with a signal, and wait for its end."""
        self._process.interrupt(number)
        try:
            self.output = self._process.ended(ENDS_S)[1]
        except subprocess.TimeoutExpired:
            raise AssertionError(f"{self.path.name}: the recorder hangs {ENDS_S:g} s after {number.name}") from None

    def require_running(self) -> None:
        """Fail, with its output, if the recorder has ended."""
        assert self._process.is_running(), f"{self.path.name}: {self._process.ended()[1]}"

    def kill(self) -> None:
        self._process.kill()


class SnapshotRecorder(Recorder):
    """A recorder in snapshot mode of a vehicle and its node `observer`; `service` has it write."""

    def __init__(self, vehicle: Vehicle, path: Path) -> None:
        name = f"recorder_{vehicle.namespace.strip('/').replace('/', '_')}"
        self.service = f"/{name}/snapshot"
        self._estimate = f"{vehicle.namespace}/observer/estimate"
        topics = [f"{vehicle.namespace}/joint_states", self._estimate, f"{vehicle.namespace}/measured_force"]
        super().__init__(path, topics, ("--snapshot-mode", "--node-name", name, "--storage", "mcap"))

    def meets(self, vehicle: Vehicle) -> None:
        """Wait until it hears the positions, beside the node."""
        wait(lambda: vehicle.position.get_subscription_count() > 1, "the recorder hears the positions")

    def has_estimates_around(self, asked_ns: int, vehicle: Vehicle) -> None:
        """End it, and see that its bag has the estimates that the vehicle heard, from before and after the request."""
        self.ends(signal.SIGINT)
        estimate = {"topic": self._estimate, "type": "sensor_msgs/msg/JointState", "field": "effort[0]"}
        signals = Signals.from_mapping({"sim_force": estimate}, "estimates")
        channel = read_recording(self.path, signals, ["sim_force"]).channel("sim_force")
        recorded = dict(zip(channel.stamps_ns.tolist(), channel.values.tolist(), strict=True))
        heard = {stamp_of(estimate): estimate.effort[0] for estimate in vehicle.estimates}
        assert len(recorded.keys() & heard.keys()) > 500
        assert not {stamp for stamp in recorded.keys() & heard.keys() if recorded[stamp] != heard[stamp]}
        assert min(recorded) < asked_ns < max(recorded)


def keep_all(path: Path, topics: Iterable[str]) -> tuple[str, str]:
    """Return the options with which a recorder or player of the bag `path` loses nothing, on a busy computer either."""
    profiles = path.with_suffix(".qos.yaml")
    profiles.write_text("".join(f"{topic}: {KEEP_ALL}\n" for topic in topics))
    return "--qos-profile-overrides-path", str(profiles)


def lossless_node(namespace: str) -> dict[str, str]:
    """Return parameters with which the observer loses none of the inputs that a player keeps all of."""
    ends = [("joint_states", "subscription"), ("stamped_current", "subscription"), ("observer/estimate", "publisher")]
    return {
        f"qos_overrides.{namespace}/{topic}.{end}.{policy}": value
        for topic, end in ends
        for policy, value in LOSSLESS.items()
    }


def play(path: Path, topics: Iterable[str], *options: str) -> None:
    """Play a bag to its end."""
    words = ["ros2", "bag", "play", str(path), "--disable-keyboard-controls", *keep_all(path, topics), *options]
    subprocess.run(words, cwd=ROOT, capture_output=True, check=True, timeout=PATIENCE_S)


def run_ces(*words: object) -> subprocess.CompletedProcess[str]:
    """Run the program `ces` of this checkout."""
    command = [sys.executable, "-m", "ces_cli.main", *map(str, words)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=PATIENCE_S)


def assert_published(values: Mapping[int, float], stamps_ns: np.ndarray, recorded: np.ndarray) -> None:
    """Fail unless the recorded samples are the first of the published ones."""
    assert stamps_ns.tolist() == list(values)[: len(stamps_ns)]
    np.testing.assert_array_equal(recorded, list(values.values())[: len(recorded)])
