"""Topics of the rig node: samples go out as messages with their own stamps, commands come in."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from operator import setitem
from typing import Any

from geometry_msgs.msg import AccelStamped, WrenchStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from ces_rig.live.patched_message import PatchedMessage
from ces_rig.live.rig import RigSample

DEPTH = 100  # a tenth of a second at 1 kHz


class RigTopics:
    """Publishers and the subscription of one rig; with `keep_all`, a full history blocks the publisher."""

    def __init__(
        self,
        node: Node,
        joint: str,
        on_command: Callable[[float], None],
        *,
        vehicle: bool,
        stamped: bool,
        clock: bool,
        keep_all: bool,
    ) -> None:
        self._node, self._joint = node, joint
        self._history = HistoryPolicy.KEEP_ALL if keep_all else HistoryPolicy.KEEP_LAST
        joints = JointState(name=[joint], position=[0.0])
        self._position = self._make_patched("joint_states", joints, partial(setitem, joints.position, 0))
        self._force = self._make_wrench("measured_force")
        self._current = self._make_stamped_current() if stamped else self._make_plain_current()
        self._body = self._make_acceleration() if vehicle else None
        self._tyre = self._make_wrench("tyre_load") if vehicle else None
        self._clocks = node.create_publisher(Clock, "/clock", 10) if clock else None
        self._clock = Clock()
        self._on_command = on_command
        qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._commands = node.create_subscription(
            Float64, "valve_command", self._on_message, qos, qos_overriding_options=_overridable()
        )

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
        self._strokes = self._node.create_subscription(
            Float64,
            "stroke_command",
            lambda message: on_stroke(message.data),
            QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT),
            qos_overriding_options=_overridable(),
        )

    def is_commanded(self) -> bool:
        """Return whether any node publishes commands."""
        return bool(self._commands.get_publisher_count() > 0)

    def _on_message(self, message: Float64) -> None:
        self._on_command(message.data)

    def _make_wrench(self, topic: str) -> PatchedMessage:
        message = WrenchStamped()
        return self._make_patched(topic, message, partial(setattr, message.wrench.force, "z"))

    def _make_acceleration(self) -> PatchedMessage:
        message = AccelStamped()
        return self._make_patched("body_acceleration", message, partial(setattr, message.accel.linear, "z"))

    def _make_patched(self, topic: str, message: Any, set_number: Callable[[float], None]) -> PatchedMessage:
        message.header.frame_id = self._joint
        return PatchedMessage(self._publisher(type(message), topic), message, set_number)

    def _make_stamped_current(self) -> Callable[[int, int, float], None]:
        message = JointState(name=[self._joint], effort=[0.0])
        return self._make_patched("valve_current", message, partial(setitem, message.effort, 0)).publish

    def _make_plain_current(self) -> Callable[[int, int, float], None]:
        """Return a function that publishes a current without its stamp."""
        publisher, message = self._publisher(Float64, "valve_current"), Float64()

        def publish(sec: int, nanosec: int, current_A: float) -> None:
            message.data = current_A
            publisher.publish(message)

        return publish

    def _publisher(self, kind: type, topic: str) -> Publisher:
        qos = QoSProfile(depth=DEPTH, history=self._history)
        return self._node.create_publisher(kind, topic, qos, qos_overriding_options=_overridable())


def _overridable() -> QoSOverridingOptions:
    return QoSOverridingOptions.with_default_policies()
