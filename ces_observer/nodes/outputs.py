"""What the nodes publish: estimates, bands and commands as bytes, desired forces, statuses as a DiagnosticArray."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from struct import Struct
from time import monotonic
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from ces_observer.cdr.signal import FIELDS, LITTLE_CDR, RawJointState
from ces_observer.health.diagnostics import LEVEL_OK, LEVEL_WARN, Report, Status
from ces_observer.health.episodes import ReasonLog

LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)  # late subscribers get the newest
OUTPUT_DEPTH = 1000  # estimates of a burst after a stall that wait for a slow reader
PROBE_STAMP_NS = 1_234_567_890_987_654_321
PROBE_FRAME = b"piston_rod"
PROBE = (0.0123, -0.456, 789.1)  # numbers that differ from each other
CHECK_NS = 100_000_000  # of stamps, between two looks for subscribers


def create_publisher(node: Node, kind: type, topic: str, depth: int) -> Publisher:
    """Return a publisher whose quality of service can be overridden by parameters; reliable by default."""
    overridable = QoSOverridingOptions.with_default_policies()
    return node.create_publisher(kind, topic, QoSProfile(depth=depth), qos_overriding_options=overridable)


def set_header(header: Any, stamp_ns: int, frame: bytes) -> None:
    """Set stamp [ns] and frame id (UTF-8) of a std_msgs/Header."""
    header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    header.frame_id = frame.decode("utf-8", "replace")


class JointStateOutput:
    """Publisher of states of the joints `names` on `topic`; only the sequences in `fields` have numbers.

    The bytes are those of RawJointState; rclpy serialises the message if it gives others.
    """

    def __init__(self, node: Node, topic: str, names: Sequence[str], fields: Sequence[str] = FIELDS) -> None:
        self.publisher = create_publisher(node, JointState, topic, OUTPUT_DEPTH)
        self._message = JointState(name=list(names))
        self._fields = fields
        raw, numbers = RawJointState(names, fields), PROBE[: len(fields) * len(names)]
        written, expected = (fill(PROBE_STAMP_NS, PROBE_FRAME, *numbers) for fill in (raw.fill, self._fill_slowly))
        self.fill = raw.fill if written == expected else self._fill_slowly

    def publish(self, stamp_ns: int, frame: bytes, *numbers: float) -> None:
        """Publish the numbers, one sequence after the other, with this stamp [ns] and frame id (UTF-8)."""
        self.publisher.publish(self.fill(stamp_ns, frame, *numbers))

    def _fill_slowly(self, stamp_ns: int, frame: bytes, *numbers: float) -> bytes:
        set_header(self._message.header, stamp_ns, frame)
        count = len(self._message.name)
        for k, field in enumerate(self._fields):
            setattr(self._message, field, array("d", numbers[k * count : (k + 1) * count]))
        return bytes(serialize_message(self._message))


class EstimateOutput:
    """Publishers of a joint's estimates on `topic`, and of the bounds of their bands on `band_topic`.

    `has_band_listeners` says whether bands are heard, which is checked every CHECK_NS; others are not published.
    """

    def __init__(self, node: Node, joint: str, topic: str, band_topic: str) -> None:
        self._node = node
        self._estimates = JointStateOutput(node, topic, [joint])
        self._bands = JointStateOutput(node, band_topic, [f"{joint}_lower", f"{joint}_upper"], ["effort"])
        self._fill, self._send = self._estimates.fill, self._estimates.publisher.publish
        self.has_band_listeners, self._checked_ns = True, 0

    def publish(
        self, stamp_ns: int, frame: bytes, position: float, speed: float, force: float, half_width: float | None
    ) -> None:
        """Publish an estimate [m, m/s, N], and its band if the half-width [N] is known."""
        self._send(self._fill(stamp_ns, frame, position, speed, force))
        if not 0 <= stamp_ns - self._checked_ns < CHECK_NS:
            self.has_band_listeners, self._checked_ns = self._bands.publisher.get_subscription_count() > 0, stamp_ns
        if half_width is not None and self.has_band_listeners:
            self._bands.publish(stamp_ns, frame, force - half_width, force + half_width)

    def close(self) -> None:
        """Withdraw both topics."""
        for output in (self._estimates, self._bands):
            self._node.destroy_publisher(output.publisher)


class CommandOutput:
    """Publisher of currents on `valve_command`, written as bytes; only the newest counts, so the queue holds one."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = create_publisher(node, Float64, "valve_command", 1)
        self._pack = Struct("<4sd").pack
        self._own_bytes = self._pack(LITTLE_CDR, PROBE[0]) == serialize_message(Float64(data=PROBE[0]))
        if not self._own_bytes:
            node.get_logger().info("this ROS serialises messages in another way: rclpy serialises the commands")

    def close(self) -> None:
        """Withdraw the topic."""
        self._node.destroy_publisher(self._publisher)

    def publish(self, current_A: float) -> None:
        """Publish a current [A]."""
        self._publisher.publish(self._pack(LITTLE_CDR, current_A) if self._own_bytes else Float64(data=current_A))


class DesiredOutput:
    """Publisher of the reachable desired force on `~/desired_force`; costs nothing without subscribers."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = create_publisher(node, WrenchStamped, "~/desired_force", 10)
        self._message = WrenchStamped()
        self.has_listeners = False

    def close(self) -> None:
        """Withdraw the topic."""
        self._node.destroy_publisher(self._publisher)

    def check_listeners(self) -> None:
        """Update `has_listeners`."""
        self.has_listeners = self._publisher.get_subscription_count() > 0

    def publish(self, stamp_ns: int, frame: bytes, force_N: float) -> None:
        """Publish the force [N] with the estimate's stamp and frame."""
        set_header(self._message.header, stamp_ns, frame)
        self._message.wrench.force.z = force_N
        self._publisher.publish(self._message)


class DamperReport(NamedTuple):
    """The report on a damper, or on the controller, with its name in diagnostics and its joint.

    Without tasks the status itself goes on /diagnostics, with all its values.
    """

    damper: str
    joint: str
    report: Report


def add_remark(status: Status, remark: str) -> Status:
    """Return the status as a warning with `remark` added to its message; unchanged without one."""
    if not remark:
        return status
    return Status(max(status.level, LEVEL_WARN), f"{status.message}; {remark}", status.values)


class DiagnosticsOutput:
    """Publisher of the tasks on /diagnostics as diagnostic_updater has them, and of all values on `~/details`."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._details: Publisher | None = None  # of a node with tasks
        self._logs: dict[str, ReasonLog] = {}

    def publish(self, reports: Sequence[DamperReport], details: bool = False) -> None:
        """Publish the tasks of each damper in one message, with `details` all values if they are heard, and log."""
        tasks = [
            self._fill(f"{of_damper.damper} {name}".strip(), of_damper.joint, status)
            for of_damper in reports
            for name, status in of_damper.report.tasks or (("", of_damper.report.status),)
        ]
        self._publish(self._publisher, tasks)
        if self._details is None and any(of_damper.report.tasks for of_damper in reports):
            self._details = self._node.create_publisher(DiagnosticArray, "~/details", 10)
        if details and self._details is not None and self._details.get_subscription_count() > 0:
            self._publish(
                self._details,
                [self._fill(of_damper.damper, of_damper.joint, of_damper.report.status) for of_damper in reports],
            )
        for of_damper in reports:
            self._log(of_damper.damper, of_damper.report)

    def _fill(self, name: str, joint: str, status: Status) -> DiagnosticStatus:
        message = DiagnosticStatus(level=bytes([status.level]), message=status.message, hardware_id=joint)
        message.name = f"{self._node.get_fully_qualified_name()}: {name}"
        message.values = [KeyValue(key=key, value=value) for key, value in status.values]
        return message

    def _publish(self, publisher: Publisher, statuses: list[DiagnosticStatus]) -> None:
        message = DiagnosticArray(status=statuses)
        message.header.stamp = self._node.get_clock().now().to_msg()
        publisher.publish(message)

    def _log(self, damper: str, report: Report) -> None:
        status = report.tasks[0][1] if report.tasks else report.status
        log = self._logs.setdefault(damper, ReasonLog())
        line = log.find_line(monotonic(), report.reason, status.message, report.changes, report.withheld)
        if line:
            logger, text = self._node.get_logger(), f"{damper}: {line}"
            if status.level == LEVEL_OK:  # rclpy knows a line of code by its level
                logger.info(text)
            else:
                logger.warning(text)
