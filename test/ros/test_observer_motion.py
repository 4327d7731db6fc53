"""A node whose model needs a measured speed: the same numbers as offline, a named reason when there is none."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, pi
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from damper_models import plain_damper
from node_process import NodeProcess
from replay import MS, START_NS, Offline, currents, jittered_positions, require_equal
from sensor_msgs.msg import JointState, Temperature
from vehicle import DEEP, JOINT, STAMPED_CURRENT, Vehicle, reliable_inputs, stroke, wait

from ces_observer.model import Model
from ces_observer.signals import MOTIONS

Start = Callable[..., NodeProcess]
SPEED, ACCELERATION = MOTIONS
STAMPED = {"type": "sensor_msgs/msg/Temperature", "field": "temperature"}
IN_JOINTS = {
    "speed.topic": "joint_states",
    "speed.type": "sensor_msgs/msg/JointState",
    "speed.field": f"velocity[{JOINT}]",
}
REPLAYED = {"max_age_s": 0.0, "wait_for_current_s": 10.0}


def model_of(motion: str) -> Model:
    return plain_damper(max_gap_s=0.3, motion=motion, motion_noise={SPEED: 0.01, ACCELERATION: 1.0}[motion])


def saved(folder: Path, motion: str) -> Path:
    model_of(motion).save(folder / "model.json")
    return folder / "model.json"


def speed_at(stamp_ns: int) -> float:
    """Return what the speed sensor measures [m/s]: 3 % more than the speed of the stroke."""
    return 1.03 * 0.02 * 4.0 * pi * cos(4.0 * pi * 1e-9 * (stamp_ns - START_NS))


def publish_joints(vehicle: Vehicle, stamp_ns: int, position_m: float, speed_m_s: float) -> None:
    message = JointState(name=["steering", JOINT], position=[1.0, position_m], velocity=[0.0, speed_m_s])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    vehicle.position.publish(message)


def test_a_speed_in_the_message_of_the_position_is_used(
    vehicle: Vehicle, start: Start, namespace: str, tmp_path: Path
) -> None:
    positions = jittered_positions(2000)
    motions = [(stamp, speed_at(stamp)) for stamp, _ in positions]
    start(
        model=saved(tmp_path, SPEED),
        **REPLAYED,
        **STAMPED_CURRENT,
        **IN_JOINTS,
        **reliable_inputs(namespace, ["joint_states", "stamped_current"]),
    )
    vehicle.meets_node()
    for stamp, current in currents(2000):
        vehicle.publish_current(stamp, current)
    for (stamp, position), (_, speed) in zip(positions, motions, strict=True):
        publish_joints(vehicle, stamp, position, speed)
    require_equal(vehicle, Offline(model_of(SPEED)).take(positions, currents(2000), motions))


@pytest.mark.parametrize("positions_first", [False, True])
def test_an_acceleration_on_its_own_topic_is_used(
    vehicle: Vehicle, start: Start, namespace: str, tmp_path: Path, positions_first: bool
) -> None:
    """Positions wait for the acceleration as they do for the current, so the order of arrival does not matter."""
    positions = jittered_positions(2000)
    motions = [(START_NS + k * MS - MS // 4, -0.02 * (4 * pi) ** 2 * stroke(k * 1e-3) / 0.02) for k in range(2010)]
    publisher = vehicle.node.create_publisher(Temperature, "acceleration", DEEP)
    start(
        model=saved(tmp_path, ACCELERATION),
        **REPLAYED,
        **STAMPED_CURRENT,
        **{f"acceleration.{key}": value for key, value in {"topic": "acceleration", **STAMPED}.items()},
        **reliable_inputs(namespace, ["joint_states", "stamped_current", "acceleration"]),
    )
    vehicle.meets_node()
    wait(lambda: publisher.get_subscription_count() > 0, "the node subscribes to the acceleration")

    def publish_motion(stamp: int, value: float) -> None:
        message = Temperature(temperature=value)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        publisher.publish(message)

    def publish_positions() -> None:
        for sample in positions:
            vehicle.publish_position(*sample)

    if positions_first:
        publish_positions()
    for sample in currents(2000):
        vehicle.publish_current(*sample)
    for sample in motions:
        publish_motion(*sample)
    if not positions_first:
        publish_positions()
    require_equal(vehicle, Offline(model_of(ACCELERATION)).take(positions, currents(2000), motions))
