"""The controller's topics: estimates and measured forces in as bytes, current commands and desired forces out."""

from __future__ import annotations

from struct import Struct

from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64

from ces_observer.cdr.joint_state import LITTLE_CDR
from ces_observer.signals import FieldPath, Signal

PROBE = -1234.5678


def estimate_signals(topic: str, joint: str) -> tuple[Signal, Signal]:
    """Return speed and force as signals of the estimates' topic; an empty `joint` means the first in the message."""
    kind, place = "sensor_msgs/msg/JointState", joint or "0"
    speed, force = (FieldPath.parse(f"{field}[{place}]") for field in ("velocity", "effort"))
    return Signal("estimate_topic", topic, kind, speed), Signal("estimate_topic", topic, kind, force)


def force_signal(topic: str) -> Signal:
    """Return the measured force as a signal."""
    return Signal("force_topic", topic, "geometry_msgs/msg/WrenchStamped", FieldPath.parse("wrench.force.z"))


class CommandOutput:
    """Publisher of currents on `valve_command`, written as bytes; only the newest counts, so the queue holds one."""

    def __init__(self, node: Node) -> None:
        self._publisher = _publisher(node, Float64, "valve_command", 1)
        self._pack = Struct("<4sd").pack
        if self._pack(LITTLE_CDR, PROBE) != serialize_message(Float64(data=PROBE)):
            node.get_logger().info("this ROS serialises messages in another way: rclpy serialises the commands")
            self.publish = self._publish_message
        else:
            self.publish = self._publish_bytes

    def _publish_bytes(self, current_A: float) -> None:
        self._publisher.publish(self._pack(LITTLE_CDR, current_A))

    def _publish_message(self, current_A: float) -> None:
        self._publisher.publish(Float64(data=current_A))


class DesiredOutput:
    """Publisher of the reachable desired force on `~/desired_force`; costs nothing without subscribers."""

    def __init__(self, node: Node) -> None:
        self._publisher = _publisher(node, WrenchStamped, "~/desired_force", 10)
        self._message = WrenchStamped()
        self.has_listeners = False

    def check_listeners(self) -> None:
        """Update `has_listeners`."""
        self.has_listeners = self._publisher.get_subscription_count() > 0

    def publish(self, stamp_ns: int, frame: bytes, force_N: float) -> None:
        """Publish the force [N] with the estimate's stamp and frame."""
        header = self._message.header
        header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        header.frame_id = frame.decode("utf-8", "replace")
        self._message.wrench.force.z = force_N
        self._publisher.publish(self._message)


def _publisher(node: Node, kind: type, topic: str, depth: int) -> Publisher:
    overridable = QoSOverridingOptions.with_default_policies()
    return node.create_publisher(kind, topic, QoSProfile(depth=depth), qos_overriding_options=overridable)
