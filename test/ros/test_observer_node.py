"""The observer node on a real ROS 2: a force for each sample, a named reason whenever there is none, recovery."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from math import inf, isfinite, nan
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from damper_models import plain_damper
from node_process import NodeProcess
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from vehicle import DEEP, JOINT, PROMISES, Vehicle, stamp_of, stroke, wait

from ces_observer.nodes.parameter_table import IN_USE

WARM_UP_S = 0.1  # of the test model
RECOVERY_S = 0.2
LONG_S = 10.0  # for which a model bridges lost samples
OFFSET_S = -30.0
Start = Callable[..., NodeProcess]


@pytest.fixture(scope="module")
def live(module_vehicle: Vehicle, module_start: Start) -> Vehicle:
    """Return a vehicle with a node that has nothing set but its model."""
    module_start()
    module_vehicle.meets_node()
    return module_vehicle


def test_live_stream(live: Vehicle) -> None:
    live.recover(RECOVERY_S + WARM_UP_S)
    live.drive_until(lambda: len(live.estimates) > 1200, "estimates")
    live.hears("estimating", None)
    tasks = {one.name.rpartition(f": {JOINT} ")[2]: one.values for one in live.statuses if f"{JOINT} " in one.name}
    assert list(tasks) == ["health", "frequency", "time stamps", "model"]
    assert 10 < sum(map(len, tasks.values())) <= 20
    assert all(b > a for a, b in zip(live.stamps(), live.stamps()[1:], strict=False))
    for message in live.estimates:
        assert (list(message.name), message.header.frame_id) == ([JOINT], "chassis")
        assert isfinite(message.position[0]) and isfinite(message.velocity[0])
        assert abs(message.effort[0]) < 8000.0


FAULTS = {
    "no usable current": {"current": None},
    "position is not finite": {"position": lambda time_s: nan if time_s % 0.1 < 0.05 else inf},
    "no joint 'rear_damper'; the message has ['steering', 'front']": {"joint": "front"},
    "position stamps are off the node's clock": {"clock_offset_s": OFFSET_S},
}


@pytest.mark.parametrize("reason", FAULTS)
def test_withholds_says_why_and_recovers(live: Vehicle, reason: str) -> None:
    recovery(live)
    told, heard = len(live.statuses), len(live.estimates)
    with live.driving(**FAULTS[reason]):
        status = live.hears(reason, None, told)
        withheld = time.time_ns()
        time.sleep(0.3)
    assert f"observer: {JOINT}" in status.name
    recovers = recovery(live)
    sent = [stamp_of(estimate) - round(OFFSET_S * 1e9) * ("clock" in reason) for estimate in live.estimates[heard:]]
    assert not [stamp for stamp in sent if withheld < stamp < recovers]


def recovery(live: Vehicle) -> int:
    """Drive until there is an estimate again, after no more samples than it takes; return when it began [ns]."""
    return live.recover(RECOVERY_S + WARM_UP_S)


def test_a_wrong_type_beside_a_good_publisher_is_mentioned(live: Vehicle) -> None:
    wrong = live.node.create_publisher(Float64, "joint_states", 1)
    with live.driving():
        live.hears("joint_states also carries std_msgs/msg/Float64, which is not read", None)
    live.node.destroy_publisher(wrong)


def test_silence_is_told_and_ends(live: Vehicle) -> None:
    live.drive(0.5)
    live.hears("joint_states has a publisher that is silent", since=len(live.statuses))
    recovery(live)


def test_publishers_that_are_lost_and_come_back(live: Vehicle) -> None:
    live.drive(0.4)
    told = len(live.statuses)
    live.node.destroy_publisher(live.position)
    live.node.destroy_publisher(live.current)
    live.hears("nothing publishes", since=told)
    live.position = live.node.create_publisher(JointState, "joint_states", DEEP)
    live.current = live.node.create_publisher(Float64, "valve_current", DEEP)
    live.meets_node()
    recovery(live)


def test_the_age_limit_can_be_lifted_while_running(live: Vehicle) -> None:
    told = len(live.statuses)
    live.drive(0.5, clock_offset_s=-1e6)
    live.hears("1e+06 s behind it, max_age_s allows 0.5 s", since=told)
    assert not live.sets("max_age_s", -1.0).successful
    assert live.sets("max_age_s", 0.0).successful
    told = len(live.statuses)
    with live.driving(clock_offset_s=-1e6):  # the current is stamped on its arrival
        live.hears("1e+06 s before the first known current: are both on one clock?", since=told)
    assert live.sets("max_age_s", 0.5).successful


def test_what_cannot_change_live_is_refused(live: Vehicle) -> None:
    for name, value in (("position.topic", "elsewhere"), ("allow_uncertified", True)):
        assert live.sets(name, value).reason == f"parameter '{name}' cannot be set because {IN_USE}"
    assert "read-only" in live.sets("executor", "single").reason
    assert live.gets("executor") == "auto"


def test_two_publishers_of_one_number_are_named(live: Vehicle) -> None:
    told, second = len(live.statuses), live.node.create_publisher(Float64, "valve_current", 1)
    live.hears("valve_current has 2 publishers, whose samples mix; expected one", None, told)
    live.node.destroy_publisher(second)


@pytest.mark.parametrize("policy", PROMISES)
def test_what_the_middleware_misses_is_silence(vehicle: Vehicle, start: Start, tmp_path: Path, policy: str) -> None:
    plain_damper(max_gap_s=LONG_S).save(tmp_path / "patient.json")
    with vehicle.promising(policy, 0.05) as overrides:
        start(model=tmp_path / "patient.json", **overrides)
        vehicle.goes_silent_within(LONG_S)


def test_a_topic_of_another_type_is_told(vehicle: Vehicle, start: Start) -> None:
    start(**{"position.type": "std_msgs/msg/Float64", "position.field": "data"})
    vehicle.hears("joint_states carries sensor_msgs/msg/JointState; position.type is std_msgs/msg/Float64")


def test_a_position_without_header_is_stamped_on_arrival(vehicle: Vehicle, start: Start) -> None:
    publisher = vehicle.node.create_publisher(Float64, "bare", 100)
    start(
        **{"position.topic": "bare", "position.type": "std_msgs/msg/Float64", "position.field": "data"},
        **{"current.constant": 0.0, "name": "front"},
    )
    wait(lambda: publisher.get_subscription_count() > 0, "the node subscribes")
    before = time.time_ns()
    with vehicle.repeating(0.002, lambda: publisher.publish(Float64(data=stroke(time.monotonic())))):
        wait(lambda: bool(vehicle.estimates), "an estimate")
    assert before < vehicle.stamps()[0] < time.time_ns()
    assert list(vehicle.estimates[0].name) == ["front"]


def test_a_measured_force_that_differs_asks_for_a_new_identification_and_a_snapshot(
    vehicle: Vehicle, start: Start
) -> None:
    start(snapshot_service="/no_recorder/snapshot", snapshot_after_s=0.5, cost_window_s=3, cost_warn_J=20.0)
    vehicle.meets_node()
    with vehicle.driving(), vehicle.measuring(1.5):
        status = vehicle.hears("re-identify: the cost J against the measured force is 3", None)
        assert "expected below 20.0%" in status.message
        assert vehicle.hears_value("snapshot", "not taken: ")  # no recorder, or no rosbag2 at all
        before = len(vehicle.estimates)
        wait(lambda: len(vehicle.estimates) > before, "an estimate after it")


@pytest.mark.parametrize(
    ("executor", "numbers"), [("events", [signal.SIGINT, signal.SIGINT]), ("single", [signal.SIGTERM])]
)
def test_a_signal_ends_the_node_in_order_under_load(
    vehicle: Vehicle, start: Start, executor: str, numbers: list[int]
) -> None:
    node = start(executor=executor)
    vehicle.meets_node()
    with vehicle.driving():
        wait(lambda: bool(vehicle.estimates), "an estimate")
        for number in numbers:
            node.interrupt(number)
        status, output = node.ended()
    assert status == 0, output
    assert "Traceback" not in output
    assert "FATAL" not in output and "ERROR" not in output
