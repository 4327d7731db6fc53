"""The topics of a rig. A message with a header and one number is serialised once and patched for each sample.

That costs a third of publishing it as usual.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial
from operator import setitem
from typing import Any

from geometry_msgs.msg import AccelStamped, WrenchStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import serialize_message
from rclpy.subscription import Subscription
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from ces_rig.live.rig import RigNodeSettings, RigSample

STAMP, NUMBER = struct.Struct("<iI"), struct.Struct("<d")
PROBE = (1_234_567_890, 987_654_321, 0.123456789)  # their places in the bytes are the places to patch


class PatchedMessage:
    """Publishes `message` with a new stamp and number each time; `set_number` writes a number into it."""

    def __init__(self, publisher: Publisher, message: Any, set_number: Callable[[float], None]) -> None:
        self._publish = publisher.publish
        message.header.stamp.sec, message.header.stamp.nanosec = PROBE[:2]
        set_number(PROBE[2])
        self._bytes = bytearray(serialize_message(message))
        self._stamp_at = self._bytes.index(STAMP.pack(*PROBE[:2]))
        self._number_at = self._bytes.index(NUMBER.pack(PROBE[2]))

    def publish(self, sec: int, nanosec: int, number: float) -> None:
        """Publish a number with a stamp."""
        STAMP.pack_into(self._bytes, self._stamp_at, sec, nanosec)
        NUMBER.pack_into(self._bytes, self._number_at, number)
        self._publish(bytes(self._bytes))


DEPTH = 100  # a tenth of a second at 1 kHz


class RigTopics:
    """Publishers and the subscription of one rig; with `keep_all`, a full history blocks the publisher."""

    def __init__(
        self, node: Node, settings: RigNodeSettings, on_command: Callable[[float], None], vehicle: bool, keep_all: bool
    ) -> None:
        self._node = node
        self._joint = joint = settings.joint
        self._history = HistoryPolicy.KEEP_ALL if keep_all else HistoryPolicy.KEEP_LAST
        joints = JointState(name=[joint], position=[0.0])
        self._position = self._make_patched("joint_states", joints, partial(setitem, joints.position, 0))
        self._force = self._make_wrench("measured_force")
        current, self._plain_current = JointState(name=[joint], effort=[0.0]), Float64()
        self._current: Callable[[int, int, float], None]
        if settings.stamped_current:
            self._current = self._make_patched("valve_current", current, partial(setitem, current.effort, 0)).publish
        else:
            self._plain_currents = self._publisher(Float64, "valve_current")
            self._current = self._publish_plain_current
        body = AccelStamped()
        set_body = partial(setattr, body.accel.linear, "z")
        self._body = self._make_patched("body_acceleration", body, set_body) if vehicle else None
        self._tyre = self._make_wrench("tyre_load") if vehicle else None
        self._clocks = node.create_publisher(Clock, "/clock", 10) if settings.publish_clock else None
        self._clock = Clock()
        self._commands = self._subscribe("valve_command", on_command)

    def publish(self, sample: RigSample, stamp_ns: int) -> None:
        """Publish the sample of `stamp_ns`: the clock first, the position last, after the signals used with it."""
        sec, nanosec = divmod(stamp_ns, 1_000_000_000)
        if self._clocks is not None:
            self._clock.clock.sec, self._clock.clock.nanosec = sec, nanosec
            self._clocks.publish(self._clock)
        if sample.current_A is not None:
            self._current(sec, nanosec, sample.current_A)
        if sample.force_N is not None:
            self._force.publish(sec, nanosec, sample.force_N)
        if self._body is not None and self._tyre is not None:
            self._body.publish(sec, nanosec, sample.body_m_s2)
            self._tyre.publish(sec, nanosec, sample.tyre_N)
        if sample.position_m is not None:
            self._position.publish(sec, nanosec, sample.position_m)

    def listen_to_strokes(self, on_stroke: Callable[[float], None]) -> None:
        """Subscribe to the set points of the stroke [m]."""
        self._strokes = self._subscribe("stroke_command", on_stroke)

    def is_commanded(self) -> bool:
        """Return whether any node publishes commands."""
        return bool(self._commands.get_publisher_count() > 0)

    def _make_wrench(self, topic: str) -> PatchedMessage:
        message = WrenchStamped()
        return self._make_patched(topic, message, partial(setattr, message.wrench.force, "z"))

    def _make_patched(self, topic: str, message: Any, set_number: Callable[[float], None]) -> PatchedMessage:
        message.header.frame_id = self._joint
        return PatchedMessage(self._publisher(type(message), topic), message, set_number)

    def _publish_plain_current(self, sec: int, nanosec: int, current_A: float) -> None:
        """Publish a current without its stamp."""
        self._plain_current.data = current_A
        self._plain_currents.publish(self._plain_current)

    def _publisher(self, kind: type, topic: str) -> Publisher:
        qos = QoSProfile(depth=DEPTH, history=self._history)
        options = QoSOverridingOptions.with_default_policies()
        return self._node.create_publisher(kind, topic, qos, qos_overriding_options=options)

    def _subscribe(self, topic: str, on_number: Callable[[float], None]) -> Subscription:
        qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
        options = QoSOverridingOptions.with_default_policies()
        return self._node.create_subscription(
            Float64, topic, lambda message: on_number(message.data), qos, qos_overriding_options=options
        )
