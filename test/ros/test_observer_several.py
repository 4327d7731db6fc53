"""Several dampers in one node, several nodes in namespaces, and messages that are read in more than one way."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import nan, sin

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from diagnostic_msgs.msg import DiagnosticStatus
from node_process import NodeProcess
from rclpy.qos import QoSReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from vehicle import Vehicle, stamp_of, wait

from ces_observer.nodes.parameter_table import IN_USE

Start = Callable[..., NodeProcess]


@dataclass
class Motorcycle:
    """A vehicle with two dampers in one joint_states, whose joints come in either order, and a node for both."""

    vehicle: Vehicle
    front: list[JointState]
    rear: list[JointState]
    count: int = 0  # of the samples published

    @contextmanager
    def driving(self, rear: Callable[[float], float] = lambda t: 0.01 * sin(9.0 * t)) -> Iterator[int]:
        """Drive at 500 Hz beside what is done in this context; yields a time before the first stamp [ns]."""
        began = time.time_ns()
        with self.vehicle.repeating(0.002, lambda: self._publish(rear)):
            yield began

    def _publish(self, rear: Callable[[float], float]) -> None:
        """Publish a sample of both, at every fifth a current."""
        t, self.count = time.monotonic(), self.count + 1
        joints = [("fork", 0.02 * sin(12.0 * t)), ("shock", rear(t)), ("steering", 1.0)]
        names, positions = zip(*(joints if self.count % 2 else reversed(joints)), strict=True)
        message = JointState(name=names, position=positions)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(time.time_ns(), 10**9)
        if self.count % 5 == 0:
            self.vehicle.current.publish(Float64(data=0.5))
        self.vehicle.position.publish(message)

    def statuses(self, damper: str) -> list[DiagnosticStatus]:
        return [status for status in self.vehicle.statuses if f": {damper}" in status.name]


@pytest.fixture(scope="module")
def motorcycle(module_vehicle: Vehicle, module_start: Start) -> Motorcycle:
    vehicle = module_vehicle
    topics = [f"observer/{damper}/estimate" for damper in ("front", "rear")]
    module_start(
        dampers="[front, rear]",
        max_age_s=60.0,
        **{"front.position.field": "position[fork]", "rear.position.field": "position[shock]"},
        **{
            "rear.max_age_s": 50.0,
            f"qos_overrides.{vehicle.namespace}/{topics[1]}.publisher.reliability": "best_effort",
        },
    )
    heard = [vehicle.hear_estimates(topic) for topic in topics]
    vehicle.meets_node(topics[1])
    return Motorcycle(vehicle, *heard)


def test_each_damper_has_its_estimates_and_its_status(motorcycle: Motorcycle) -> None:
    with motorcycle.driving():
        for heard in (motorcycle.front, motorcycle.rear):
            wait(lambda heard=heard: len(heard) > 400, "estimates")
    for heard, joint, most_m in ((motorcycle.front, "fork", 0.02), (motorcycle.rear, "shock", 0.01)):
        assert all(list(message.name) == [joint] for message in heard)
        positions = [message.position[0] for message in heard]
        assert 0.8 * most_m < max(positions) < 1.2 * most_m
        damper = "front" if joint == "fork" else "rear"
        wait(lambda d=damper: any("estimating" in s.message for s in motorcycle.statuses(d)), f"a status of {damper}")
        assert {status.hardware_id for status in motorcycle.statuses(damper)} == {joint}


def test_what_fails_for_one_does_not_touch_the_other(motorcycle: Motorcycle) -> None:
    with motorcycle.driving(rear=lambda t: nan) as fails:
        wait(lambda: any("position is not finite" in s.message for s in motorcycle.statuses("rear")), "the failure")
        wait(lambda: len([m for m in motorcycle.front if stamp_of(m) > fails]) > 280, "the other's estimates")
    assert not any("finite" in s.message for s in motorcycle.statuses("front"))
    assert len([m for m in motorcycle.rear if stamp_of(m) > fails]) < 5


def test_a_topic_with_several_joints_is_subscribed_to_once(motorcycle: Motorcycle) -> None:
    vehicle = motorcycle.vehicle
    for topic in ("joint_states", "valve_current"):
        readers = vehicle.node.get_subscriptions_info_by_topic(f"{vehicle.namespace}/{topic}")
        assert [reader.node_name for reader in readers] == ["observer"]
        assert readers[0].qos_profile.reliability == QoSReliabilityPolicy.BEST_EFFORT


def test_quality_of_service_can_be_overridden(motorcycle: Motorcycle) -> None:
    vehicle, found = motorcycle.vehicle, []
    for damper in ("front", "rear"):
        (writer,) = vehicle.node.get_publishers_info_by_topic(f"{vehicle.namespace}/observer/{damper}/estimate")
        found.append(writer.qos_profile.reliability)
    assert found == [QoSReliabilityPolicy.RELIABLE, QoSReliabilityPolicy.BEST_EFFORT]


def test_a_parameter_of_all_holds_unless_a_damper_has_its_own(motorcycle: Motorcycle) -> None:
    vehicle = motorcycle.vehicle
    assert (vehicle.gets("front.max_age_s"), vehicle.gets("rear.max_age_s")) == (None, 50.0)
    assert not vehicle.sets("front.max_age_s", -1.0).successful
    assert IN_USE in vehicle.sets("front.position.topic", "elsewhere").reason
    assert vehicle.sets("max_age_s", 1e-9).successful
    try:
        with motorcycle.driving():
            told = "max_age_s allows 1e-09 s"
            wait(lambda: any(told in s.message for s in motorcycle.statuses("front")), "all's limit")
        assert not any("max_age_s allows" in s.message for s in motorcycle.statuses("rear"))
    finally:
        assert vehicle.sets("max_age_s", 60.0).successful


def test_a_message_that_only_rclpy_can_read_is_read_by_it(start: Start, vehicle: Vehicle) -> None:
    start()
    vehicle.meets_node()
    big_endian = b"\x00\x00\x00\x00" + struct.pack(">d", 0.5)
    with vehicle.driving(current=None):
        wait(lambda: vehicle.current.publish(big_endian) or len(vehicle.estimates) > 100, "estimates")
        vehicle.hears_value("unexpected errors", "0, the last: none")


def test_messages_that_are_none_do_not_end_the_node(start: Start, vehicle: Vehicle) -> None:
    start()
    vehicle.meets_node()
    for raw in (b"", b"\x00", b"\x00\x01\x00\x00", b"\xff" * 7, b"\x00\x01\x00\x00" + b"\xff" * 500):
        for _ in range(20):
            vehicle.position.publish(raw)
            vehicle.current.publish(raw)
    vehicle.drive_until(lambda: bool(vehicle.estimates), "an estimate")
