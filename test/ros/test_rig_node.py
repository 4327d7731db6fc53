"""The rig node on a real ROS 2: true stamps at the rate, a damper that obeys, time of its own, an end in order."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

import numpy as np
import rclpy
from geometry_msgs.msg import AccelStamped, WrenchStamped
from node_process import NodeProcess, ros_args
from party import Party
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from vehicle import stamp_of, wait

MS = 1_000_000
DEEP = QoSProfile(depth=5000)
STROKE = 250  # samples, at 4 Hz
Start = Callable[..., NodeProcess]


class Bench(Party):
    """What stands around the rig: hears all it publishes, commands the valve."""

    def __init__(self, namespace: str) -> None:
        super().__init__("bench", namespace)
        self.heard: dict[str, list] = {}
        self._listen("joint_states", JointState)
        self._listen("measured_force", WrenchStamped)
        self._listen("body_acceleration", AccelStamped)
        self._listen("tyre_load", WrenchStamped)
        self._listen("clock", Clock)
        self._commands = self.node.create_publisher(Float64, "valve_command", 10)

    def listen_to_current(self, kind: type) -> None:
        self._listen("valve_current", kind)

    @contextmanager
    def commanding(self, current_A: float) -> Iterator[None]:
        """Command at 100 Hz beside what is done in this context."""
        with self.repeating(0.01, lambda: self._commands.publish(Float64(data=current_A))):
            yield

    def stays_at(self, current_A: float) -> None:
        """Wait until the damper's current has been this one for a stroke, and its force heard meanwhile."""

        def stays() -> bool:
            heard = [message.data for message in list(self.heard["valve_current"])[-STROKE:]]
            return len(heard) == STROKE and heard == pytest.approx([current_A] * STROKE, abs=0.01)

        wait(stays, f"{current_A} A for a stroke")

    def least_force_N(self) -> float:
        """Return the least force measured in the stroke that begins now."""
        ends = time.time_ns() + STROKE * MS
        wait(lambda: self.newest("measured_force") >= ends, "the forces of a stroke")
        return min(message.wrench.force.z for message in list(self.heard["measured_force"])[-STROKE:])

    def set(self, **values: object) -> tuple[bool, str]:
        result = self.set_parameters("rig", {name.replace("__", "."): value for name, value in values.items()})
        return result.successful, result.reason

    def newest(self, topic: str) -> int:
        """Return the last stamp heard [ns]."""
        return stamp_of(self.heard[topic][-1])

    def stamps(self, topic: str) -> np.ndarray:
        return np.array([stamp_of(message) for message in list(self.heard[topic])])

    def hears(self, topic: str, count: int) -> None:
        wait(lambda: len(self.heard[topic]) >= count, f"{count} of {topic}")

    def forget(self) -> None:
        for messages in self.heard.values():
            messages.clear()

    def _listen(self, topic: str, kind: type) -> None:
        self.heard[topic] = []
        self.node.create_subscription(kind, topic, self.heard[topic].append, DEEP)


@pytest.fixture
def bench(namespace: str) -> Iterator[Bench]:
    with Bench(namespace) as bench:
        yield bench


@pytest.fixture
def rig(namespace: str) -> Iterator[Start]:
    """Yield a function that starts the node in the test's namespace."""
    started: list[NodeProcess] = []

    def start(**parameters: object) -> NodeProcess:
        words = {name.replace("__", "."): value for name, value in parameters.items()}
        started.append(NodeProcess.from_source(namespace, words, "ces_rig.live.node"))
        return started[-1]

    yield start
    for node in started:
        node.kill()


def test_samples_come_at_the_rate_with_true_stamps_and_the_damper_obeys(bench: Bench, rig: Start) -> None:
    bench.listen_to_current(Float64)
    node = rig(script__frequency_Hz=4.0, command_timeout_s=1.0)
    bench.hears("joint_states", 100)
    assert bench.heard["joint_states"][0].name == ["rear_damper"]
    assert bench.heard["valve_current"][-1].data == pytest.approx(0.4, abs=0.01)  # safe current
    bench.forget()
    with bench.commanding(2.0):  # beyond what the valve takes
        bench.stays_at(1.6)
        firm = bench.least_force_N()
    read = bench.stamps("measured_force")[10:]
    wait(lambda: bench.newest("joint_states") >= max(read[-1], time.time_ns() - 200 * MS), "samples of now")
    stamps = bench.stamps("joint_states")
    assert set(np.diff(stamps).tolist()) == {MS}
    assert set(read.tolist()) <= set(stamps.tolist())  # read at the same instants
    bench.stays_at(0.4)  # the command is too old
    assert firm < 1.4 * bench.least_force_N() < -500.0
    position = np.array([message.position[0] for message in list(bench.heard["joint_states"])[-500:]])
    assert np.abs(position).max() == pytest.approx(0.015, rel=0.02)
    assert bench.set(script__amplitude_m=0.08) == (
        False,
        "rig: the stroke reaches 0.08 m; the damper's ends are at ±0.06 m",
    )
    assert bench.set(script__amplitude_m=0.004) == (True, "")
    bench.forget()
    bench.hears("joint_states", 1000)
    late = [message.position[0] for message in list(bench.heard["joint_states"])[-250:]]
    assert np.abs(late).max() == pytest.approx(0.004, rel=0.03)
    node.interrupt(signal.SIGSTOP)
    time.sleep(0.3)
    node.interrupt(signal.SIGCONT)
    bench.hears("joint_states", 1500)
    assert set(np.diff(bench.stamps("joint_states")).tolist()) == {MS}  # no sample is lost in a stall
    node.interrupt()
    status, output = node.ended()
    assert status == 0, output
    assert "Traceback" not in output


def test_a_vehicle_in_its_own_time(bench: Bench, rig: Start) -> None:
    bench.listen_to_current(JointState)
    node = rig(
        drive="vehicle", publish_clock="true", real_time_factor=0.5, use_sim_time="true", stamped_current="true",
        rate_hz=200, vehicle__road_class="D",
    )  # fmt: skip
    bench.hears("joint_states", 20)

    def rig_time_per_time() -> float:
        before, began = len(bench.heard["joint_states"]), time.monotonic()
        bench.hears("joint_states", before + 200)
        return 200 * 5e-3 / (time.monotonic() - began)

    wait(lambda: rig_time_per_time() == pytest.approx(0.5, rel=0.25), "half as fast, when nothing holds it up")
    stamps = bench.stamps("joint_states")
    assert set(np.diff(stamps).tolist()) == {5 * MS}
    clock = [message.clock.sec * 10**9 + message.clock.nanosec for message in list(bench.heard["clock"])]
    assert set(stamps.tolist()) & set(clock)
    assert stamps[-1] < 600 * 10**9  # not this computer's time
    current = bench.heard["valve_current"][-1]
    assert current.name == ["rear_damper"]
    assert current.effort[0] == pytest.approx(0.4, abs=0.01)
    assert stamp_of(current) % (5 * MS) == 0
    body = np.array([message.accel.linear.z for message in list(bench.heard["body_acceleration"])])
    tyre = np.array([message.wrench.force.z for message in list(bench.heard["tyre_load"])])
    assert 0.5 < body.std() < 10.0
    assert tyre.mean() == pytest.approx((145 + 17) * 9.81, rel=0.05)
    assert tyre.min() >= 0.0
    node.interrupt(signal.SIGTERM)
    assert node.ended()[0] == 0


def test_as_fast_as_it_is_answered(bench: Bench, rig: Start) -> None:
    """Each sample waits for the command that answers it: no clock has a say in a closed loop then."""
    answers, answered, silent = [], [], threading.Event()

    def answer(message: JointState) -> None:
        if silent.is_set():
            return
        if len(answers) < 100:
            time.sleep(0.01)  # falls behind while samples still come unasked for
        answered.append(stamp_of(message))
        answers.append(0.3 + 0.1 * (stamp_of(message) // MS % 4))
        bench._commands.publish(Float64(data=answers[-1]))

    bench.node.create_subscription(JointState, "joint_states", answer, DEEP)
    bench.listen_to_current(Float64)
    rig(publish_clock="true", real_time_factor=0.0, answer_s=5.0, noise=0.0)
    bench.hears("joint_states", 2500)  # those that flow freely until it is seen that they are answered, and more
    assert set(np.diff(bench.stamps("joint_states")).tolist()) == {MS}
    assert abs(len(answers) - len(bench.heard["joint_states"])) < 5

    def waits() -> bool:
        silent.set()
        time.sleep(0.3)  # what was on its way has come
        last = bench.stamps("joint_states")[-1]
        time.sleep(0.3)
        is_still = bench.stamps("joint_states")[-1] == last
        silent.clear()
        bench._commands.publish(Float64(data=0.3))
        return is_still

    wait(waits, "no sample comes without an answer, as soon as they have stopped to flow freely")


MISTAKES = {
    "use_sim_time is true, but the rig is the source of time": {"use_sim_time": "true"},
    "parameter 'script.kind' is 'square'; expected one of rest, sine": {"script__kind": "square"},
    "the stroke reaches 0.07 m": {"script__amplitude_m": 0.07},
    "no effect 'frction'": {"withheld": "['frction']"},
    "rate_hz": {"rate_hz": 100},
}


def test_a_mistake_at_start_is_one_fatal_line_and_status_2(rig: Start) -> None:
    status, output = rig(damper="/nowhere.yaml").ended()
    assert status == 2
    assert len(output.splitlines()) == 1, output
    assert "[FATAL]" in output
    assert "/nowhere.yaml: cannot be read: No such file" in output


@pytest.mark.parametrize("line", MISTAKES)
def test_every_mistake_is_refused_while_the_node_is_built(line: str) -> None:
    """The same in this process, which is quicker."""
    from ces_observer.nodes.executors import START_ERRORS
    from ces_observer.nodes.parameters import TableNode
    from ces_rig.live.node import declare_settings
    from ces_rig.live.rig import LiveRig

    rclpy.init(args=ros_args("/mistake", {name.replace("__", "."): value for name, value in MISTAKES[line].items()}))
    try:
        with pytest.raises(START_ERRORS, match=line.replace("[", r"\[")):
            LiveRig(declare_settings(TableNode("rig"))[1])
    finally:
        rclpy.shutdown()
