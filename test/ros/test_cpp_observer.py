"""The observer in C++ beside the one in Python: the same faulty inputs give the same estimates, reasons and words."""

from __future__ import annotations

import random
import re
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from bands import BAND
from cpp_core import save_flat
from cpp_package import PACKAGE, CppPackage, missing_tool
from damper_models import delayed_damper
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from node_process import NodeProcess
from parameter_cases import AT_START, wrong_type
from party import require_answers
from patience import PATIENCE_S
from replay import MS, Offline, S, Samples, faulty_segments, numbers_of
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from vehicle import DEEP, JOINT, STAMPED_CURRENT, Vehicle, lossless_topics, stamp_of, stroke, wait

from ces_observer.model import Model, load_model

pytestmark = pytest.mark.skipif(bool(missing_tool()), reason=f"{missing_tool()} is missing")

NODES = ("observer", "cpp_observer")
AT_ONCE, LATE = ("estimate", "estimate_band"), ("estimate_delayed", "estimate_delayed_band")
TOPICS = (*AT_ONCE, *LATE)
INPUTS = ("joint_states", "stamped_current")
OUTPUTS = [f"{name}/{topic}" for name in NODES for topic in TOPICS]
LISTED = (
    *("position samples", "forces estimated", "messages without the field", "position: duplicates", "jumps of time"),
    "delay_s",
)


class Pair:
    """Both nodes in one namespace, and what each of them publishes."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle = vehicle
        self.heard = {name: {topic: self._hear(f"{name}/{topic}") for topic in TOPICS} for name in NODES}
        self.estimates = {name: self.heard[name]["estimate"] for name in NODES}
        self.statuses: dict[str, list[DiagnosticStatus]] = {name: [] for name in NODES}
        self.details: dict[str, dict[str, str]] = {name: {} for name in NODES}
        for topic in ("/diagnostics", *(f"{name}/details" for name in NODES)):
            vehicle.node.create_subscription(DiagnosticArray, topic, self._hear_statuses, DEEP)

    def meet(self, topics: Sequence[str]) -> None:
        """Wait until both nodes hear the vehicle and offer `topics`."""
        wait(lambda: self.vehicle.position.get_subscription_count() == 2, "both nodes subscribe to position")
        for name in NODES:
            wait(
                lambda name=name: all(self.vehicle.node.count_publishers(f"{name}/{topic}") for topic in topics),
                f"{name} offers estimates",
            )
        time.sleep(0.5)

    def wait_for_values(self, key: str, text: str) -> None:
        """Wait until both nodes report `text` as the value of `key`."""
        for name in NODES:
            wait(lambda name=name: text in self.values(name).get(key, ""), f"'{text}' as '{key}' of {name}")

    def agree_on(self, key: str) -> bool:
        """Return whether both nodes report the same value; those of a window appear with its end."""
        values = [self.values(name).get(key) for name in NODES]
        return values[0] is not None and values[0] == values[1]

    def values(self, name: str) -> dict[str, str]:
        """Return the newest values of a node's details."""
        return self.details[name]

    def drive_until(self, text: str, **options: Any) -> None:
        """Drive until both nodes have said `text`, their numbers replaced by #."""
        since = {name: len(self.statuses[name]) for name in NODES}
        with self.vehicle.driving(**options):
            for name in NODES:
                wait(
                    lambda name=name: any(text in said for said in self.messages(name, since[name])),
                    f"'{text}' from {name}",
                )

    def messages(self, name: str, since: int) -> set[str]:
        """Return what a node has said after its first `since` statuses, without its numbers."""
        texts = (status.message.replace(self.vehicle.namespace, "/#") for status in self.statuses[name][since:])
        return {re.sub(r"[0-9.e+-]*[0-9]", "#", text) for text in texts}

    def _hear(self, topic: str) -> list[JointState]:
        heard: list[JointState] = []
        self.vehicle.node.create_subscription(JointState, topic, heard.append, DEEP)
        return heard

    def _hear_statuses(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node, _, task = status.name.partition(": ")
            name = node.removeprefix(f"{self.vehicle.namespace}/")
            if name in self.statuses:
                self.statuses[name].append(status)
                if task == JOINT:
                    self.details[name] = {value.key: value.value for value in status.values}


@pytest.fixture
def start_pair(
    vehicle: Vehicle, namespace: str, package: CppPackage, banded_path: Path, flat_path: Path, tmp_path: Path
) -> Iterator[Callable[..., Pair]]:
    """Yield a function that starts both nodes with the same model, `late` with a delay, and the same parameters."""
    started: list[NodeProcess] = []

    def start(late: bool = False, **parameters: object) -> Pair:
        pair, model, flat = Pair(vehicle), banded_path, flat_path
        if late:
            model = tmp_path / "late.json"
            replace(late_damper(), band=BAND).save(model)
            flat = save_flat(load_model(model), tmp_path / "late.ces")
        given = {**lossless_topics(namespace, INPUTS, OUTPUTS), **parameters}
        started.append(NodeProcess.from_source(namespace, {"model": model, **given}))
        started.append(package.start(namespace, NODES[1], {"model": flat, **given}))
        pair.meet(LATE if late else AT_ONCE)
        return pair

    yield start
    for node in started:
        node.kill()


@pytest.mark.parametrize(("executor", "delays_ms", "late"), [("events", (0, 0), False), ("single", (20, -15), True)])
def test_faulty_samples_give_the_estimates_of_an_estimator_that_is_fed_them(
    start_pair: Callable[..., Pair], executor: str, delays_ms: tuple[int, int], late: bool
) -> None:
    delays = {f"{name}.delay": ms * 1e-3 for name, ms in zip(("position", "current"), delays_ms, strict=True)}
    pair = start_pair(late, executor=executor, max_age_s=0.0, wait_for_current_s=10.0, **STAMPED_CURRENT, **delays)
    topic, key = (LATE[0], "delayed forces estimated") if late else (AT_ONCE[0], "forces estimated")
    python, cpp = (pair.heard[name][topic] for name in NODES)
    offline, expected, count = Offline(late_damper() if late else None), {}, 0
    for segment in faulty_segments():
        pair.vehicle.publish_burst(segment.positions, segment.currents, is_in_order=not late)
        samples = (segment.positions, segment.currents)
        expected |= offline.take(*(earlier(one, ms) for one, ms in zip(samples, delays_ms, strict=True)))
        count += len(segment.positions)
        for heard in (python, cpp):
            wait(lambda heard=heard, so_far=expected: len(heard) >= len(so_far), "the estimates of a segment")
    pair.wait_for_values("position samples", str(count))
    pair.wait_for_values(key, str(len(expected)))
    assert [(stamp_of(message), numbers_of(message)) for message in cpp] == list(expected.items())
    assert_equal_messages(python, cpp)
    bands = [pair.heard[name][f"{topic}_band"] for name in NODES]
    wait(lambda: len(bands[0]) == len(bands[1]) == len(python), f"all bands of {topic}")
    assert_equal_messages(*bands)
    counts = [withheld(pair.values(name)) for name in NODES]
    assert counts[0] == counts[1]
    assert set(counts[0]) >= {"warming up", "position is not finite", "no usable current", "position is an outlier"}
    assert "stamp repeats or runs backwards" in counts[0]
    for key in LISTED:
        wait(lambda key=key: pair.agree_on(key), f"the same '{key}'")


def late_damper() -> Model:
    return delayed_damper(0.003, max_gap_s=0.3)


def earlier(samples: Samples, by_ms: int) -> Samples:
    return [(stamp - by_ms * MS, value) for stamp, value in samples]


def assert_equal_messages(ones: list[JointState], others: list[JointState]) -> None:
    assert [stamp_of(message) for message in ones] == [stamp_of(message) for message in others]
    for one, other in zip(ones, others, strict=True):
        assert (one.name, one.header.frame_id) == (other.name, other.header.frame_id)
        for field in ("position", "velocity", "effort"):
            assert list(getattr(other, field)) == list(getattr(one, field))


def withheld(values: dict[str, str]) -> dict[str, str]:
    return {key.removeprefix("withheld: "): value for key, value in values.items() if key.startswith("withheld: ")}


def test_words_and_keys_of_the_diagnostics_are_the_same(start_pair: Callable[..., Pair]) -> None:
    pair = start_pair(**{"current.constant": "null"})  # not set, as `ros2 param dump` writes it
    situations: tuple[tuple[str, dict[str, Any]], ...] = (
        ("no usable current: /#/valve_current has a publisher that is silent", {"current": None}),
        ("estimating; recovered from no usable current, then warming up (# s)", {}),
        ("the current is stamped # s off them: by another clock? current.delay takes", {"clock_offset_s": -0.3}),
        ("off the node's clock: # s behind it, max_age_s allows # s; for a replay", {"clock_offset_s": -2.0}),
        ("no joint 'rear_damper'; the message has ['steering', 'front_damper']", {"joint": "front_damper"}),
        ("position is not finite", {"position": lambda time_s: nan}),
        ("the position has not changed for # s: at rest, or its sensor is stuck", {"position": lambda time_s: 0.01}),
        ("% withheld in the last second", {}),
    )
    for text, options in situations:
        pair.drive_until(text, **options)
    python, cpp = NODES
    wait(lambda: keys_of(pair, python) - {"snapshot"} == keys_of(pair, cpp), "the same keys in the newest details")


def keys_of(pair: Pair, name: str) -> set[str]:
    return {key for key in pair.values(name) if not key.startswith(("withheld: ", "recorded"))}


def test_jumps_of_simulated_time_restart_both(start_pair: Callable[..., Pair]) -> None:
    pair = start_pair(use_sim_time=True, **{"current.constant": 0.5})
    clock = pair.vehicle.node.create_publisher(Clock, "clock", 10)
    for from_ns in (80 * S, 20 * S):
        for k in range(400):
            if k % 10 == 0:
                time.sleep(0.01)
                message = Clock()
                message.clock.sec, message.clock.nanosec = divmod(from_ns + k * MS, S)
                clock.publish(message)
                time.sleep(0.01)
            pair.vehicle.publish_position(from_ns + k * MS, stroke(k * 1e-3))
        pair.wait_for_values("position samples", "400" if from_ns > 50 * S else "800")
    pair.wait_for_values("jumps of time", "1, the last: simulated time jumped by -60.")
    stamps = [[stamp_of(message) for message in pair.estimates[name]] for name in NODES]
    for name, found in zip(NODES, stamps, strict=True):
        assert any(stamp > 80 * S for stamp in found), name
        assert any(20 * S < stamp < 21 * S for stamp in found), name


def test_the_package_builds_without_a_warning(package: CppPackage) -> None:
    assert "warning:" not in package.log


def test_malformed_messages_do_not_end_it(start_pair: Callable[..., Pair]) -> None:
    pair = start_pair(**STAMPED_CURRENT)
    chance = random.Random(3)
    for topic in (pair.vehicle.position, pair.vehicle.stamped_current):
        for length in (*range(40), 1000, 70_000):
            topic.publish(b"\x00\x01\x00\x00" + chance.randbytes(length))
    with (
        pair.vehicle.driving(),
        pair.vehicle.repeating(0.01, lambda: pair.vehicle.publish_current(time.time_ns(), 0.5)),
    ):
        for name in NODES:
            wait(lambda name=name: len(pair.estimates[name]) > 100, f"estimates of {name}")


def test_two_signals_may_share_a_message(start_pair: Callable[..., Pair]) -> None:
    shared = {"current.topic": "joint_states", "current.type": "sensor_msgs/msg/JointState"}
    pair = start_pair(**shared, **{"current.field": "position[steering]", "current.scale": 0.5})
    for name in NODES:
        pair.vehicle.drive_until(
            lambda name=name: len(pair.estimates[name]) > 100, f"estimates of {name}", current=None
        )


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        *(({name: text}, words) for words, (name, _, text) in AT_START.items()),
        (
            {"position.field": "postion[rear_damper]"},
            "no 'postion'; known are header, name, position, velocity, effort",
        ),
        ({"position.type": "no_msgs/msg/Such"}, "message type 'no_msgs/msg/Such' is not installed"),
        ({"position.topic": "not a topic"}, "'not a topic' is not a topic name"),
        ({"current.scale": 0.0}, "scale is 0"),
        ({"model": '""'}, "parameter 'model' is not set; expected the absolute path of a flat model file"),
        ({"model": "m.ces"}, "parameter 'model' is 'm.ces'; expected the absolute path"),
        ({"model": "/no/m.ces"}, "/no/m.ces: no such model file"),
        ({"current.constant": 1}, wrong_type("current.constant", "double", "integer")),
    ],
)
def test_a_wrong_parameter_ends_the_program_with_one_line(
    package: CppPackage, namespace: str, flat_path: Path, parameters: dict[str, Any], message: str
) -> None:
    status, output = package.start(namespace, NODES[1], {"model": flat_path, **parameters}).ended()
    fatal = [line for line in output.splitlines() if "[FATAL]" in line]
    assert status == 2, output
    assert len(fatal) == 1
    assert message in fatal[0]


def test_live_parameters_are_checked_and_applied(
    vehicle: Vehicle, namespace: str, package: CppPackage, flat_path: Path
) -> None:
    node = package.start(namespace, "observer", {"model": flat_path, "current.constant": 0.5})
    try:
        vehicle.meets_node()
        require_answers(vehicle, "observer")
        assert vehicle.sets("max_age_s", 0.0).successful
        vehicle.drive_until(lambda: len(vehicle.estimates) > 100, "estimates of old positions", clock_offset_s=-20.0)
    finally:
        node.kill()


def test_it_runs_in_a_container(vehicle: Vehicle, namespace: str, package: CppPackage, flat_path: Path) -> None:
    words = ["ros2", "run", "rclcpp_components", "component_container", "--ros-args", "-r", f"__ns:={namespace}"]
    container = NodeProcess(words, package.environment)
    try:
        launch = ["ros2", "launch", PACKAGE, "observer.launch.py", f"namespace:={namespace}", f"model:={flat_path}"]
        launched = subprocess.Popen(
            [*launch, f"container:={namespace}/ComponentManager"], env=package.environment, start_new_session=True
        )
        vehicle.meets_node()
        vehicle.drive_until(lambda: len(vehicle.estimates) > 100, "estimates from the container")
        launched.terminate()
        launched.wait(PATIENCE_S)
    finally:
        container.kill()
