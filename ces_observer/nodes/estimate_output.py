"""The topics of estimates and bands: numbers in, sensor_msgs/JointState out, written as bytes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from array import array
from collections.abc import Callable
from typing import ClassVar

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from ces_observer.cdr.joint_state import RawBand, RawEstimate

Publish = Callable[..., bytes]
TYPE = "sensor_msgs/msg/JointState"
OUTPUT_DEPTH = 1000  # estimates of a burst after a stall that wait for a slow reader
PROBE_STAMP_NS = 1_234_567_890_987_654_321
PROBE_FRAME = "piston_rod"


class JointStateOutput(ABC):
    """Publisher of joint states on `topic`; reliable unless overridden.

    `publish(stamp_ns, frame, *numbers)` takes the stamp [ns], the frame id as UTF-8 and the numbers of the subclass,
    and returns the published bytes. rclpy serialises the message if its bytes differ from those written by `fill`.
    """

    probe: ClassVar[tuple[float, ...]]  # numbers that differ from each other

    def __init__(self, node: Node, topic: str, fill: Publish, names: list[str]) -> None:
        self._publisher = node.create_publisher(
            JointState,
            topic,
            QoSProfile(depth=OUTPUT_DEPTH),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )
        self._message = JointState(name=names)
        self._fill = fill
        self.publish: Publish = self._publish_bytes if self._bytes_are_right() else self._publish_message

    @property
    def topic(self) -> tuple[str, str]:
        """Resolved name and type."""
        return self._publisher.topic_name, TYPE

    @abstractmethod
    def _set_numbers(self, *numbers: float) -> None:
        """Set the numbers in the one message."""

    def _bytes_are_right(self) -> bool:
        """Return whether rclpy serialises a message to the bytes written here."""
        own = self._fill(PROBE_STAMP_NS, PROBE_FRAME.encode(), *self.probe)
        return own == bytes(serialize_message(self._fill_message(PROBE_STAMP_NS, PROBE_FRAME, *self.probe)))

    def _publish_bytes(self, stamp_ns: int, frame: bytes, *numbers: float) -> bytes:
        raw = self._fill(stamp_ns, frame, *numbers)
        self._publisher.publish(raw)
        return raw

    def _publish_message(self, stamp_ns: int, frame: bytes, *numbers: float) -> bytes:
        message = self._fill_message(stamp_ns, frame.decode("utf-8", "replace"), *numbers)
        raw = bytes(serialize_message(message))
        self._publisher.publish(raw)
        return raw

    def _fill_message(self, stamp_ns: int, frame: str, *numbers: float) -> JointState:
        """Fill in the one message and return it."""
        header = self._message.header
        header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        header.frame_id = frame
        self._set_numbers(*numbers)
        return self._message


class EstimateOutput(JointStateOutput):
    """Publisher of estimates of the joint `name`: `publish(stamp_ns, frame, position, speed, force)`, m, m/s, N."""

    probe = (0.0123, -0.456, 789.1)

    def __init__(self, node: Node, topic: str, name: str) -> None:
        super().__init__(node, topic, RawEstimate(name).fill, [name])

    def _set_numbers(self, *numbers: float) -> None:
        position, speed, force = numbers
        self._message.position = array("d", [position])
        self._message.velocity = array("d", [speed])
        self._message.effort = array("d", [force])


class BandOutput(JointStateOutput):
    """Publisher of bounds of the joint `name`, as joints NAME_lower and NAME_upper.

    `publish(stamp_ns, frame, lower, upper)` takes N.
    """

    probe = (-789.1, 912.3)

    def __init__(self, node: Node, topic: str, name: str) -> None:
        raw = RawBand(name)
        super().__init__(node, topic, raw.fill, list(raw.names))

    def _set_numbers(self, *numbers: float) -> None:
        self._message.effort = array("d", numbers)
