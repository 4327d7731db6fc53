"""The topic of the estimates: numbers in, a sensor_msgs/JointState of one joint out, written as bytes."""

from __future__ import annotations

from array import array
from collections.abc import Callable

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from ces_observer.cdr.joint_state import RawEstimate

Publish = Callable[[int, bytes, float, float, float], bytes]
TYPE = "sensor_msgs/msg/JointState"
OUTPUT_DEPTH = 1000  # as of the inputs: a burst after a stall is published completely
PROBE = (1_234_567_890_987_654_321, "piston_rod", 0.0123, -0.456, 789.1)


class EstimateOutput:
    """Publisher of estimates of the joint `name` on `topic`; reliable unless overridden.

    `publish(stamp_ns, frame, position, speed, force)` takes the stamp [ns], the frame id as UTF-8, m, m/s and N, and
    returns the published bytes. rclpy serialises the message if its bytes differ from those written here.
    """

    def __init__(self, node: Node, topic: str, name: str) -> None:
        self._publisher = node.create_publisher(
            JointState,
            topic,
            QoSProfile(depth=OUTPUT_DEPTH),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )
        self._message = JointState(name=[name])
        self._fill = RawEstimate(name).fill
        self.publish: Publish = self._publish_bytes if self._bytes_are_right() else self._publish_message

    @property
    def topic(self) -> tuple[str, str]:
        """Resolved name and type."""
        return self._publisher.topic_name, TYPE

    def _bytes_are_right(self) -> bool:
        """Return whether rclpy serialises an estimate to the bytes written here."""
        stamp_ns, frame, *numbers = PROBE
        own = self._fill(stamp_ns, frame.encode(), *numbers)
        return own == bytes(serialize_message(self._fill_message(stamp_ns, frame, *numbers)))

    def _publish_bytes(self, stamp_ns: int, frame: bytes, position: float, speed: float, force: float) -> bytes:
        raw = self._fill(stamp_ns, frame, position, speed, force)
        self._publisher.publish(raw)
        return raw

    def _publish_message(self, stamp_ns: int, frame: bytes, position: float, speed: float, force: float) -> bytes:
        message = self._fill_message(stamp_ns, frame.decode("utf-8", "replace"), position, speed, force)
        raw = bytes(serialize_message(message))
        self._publisher.publish(raw)
        return raw

    def _fill_message(self, stamp_ns: int, frame: str, position: float, speed: float, force: float) -> JointState:
        """Fill in the one message and return it."""
        header = self._message.header
        header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        header.frame_id = frame
        self._message.position = array("d", [position])
        self._message.velocity = array("d", [speed])
        self._message.effort = array("d", [force])
        return self._message
