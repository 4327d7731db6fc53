"""What the nodes publish: estimates, bands, commands and desired forces, statuses as a DiagnosticArray."""

from __future__ import annotations

from collections.abc import Sequence
from time import monotonic
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from ces_observer.health.diagnostics import LEVEL_OK, LEVEL_WARN, Report, Status
from ces_observer.health.episodes import ReasonLog

LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)  # late subscribers get the newest
OUTPUT_DEPTH = 1000  # estimates of a burst after a stall that wait for a slow reader
CHECK_NS = 100_000_000  # of stamps, between two looks for subscribers


def create_publisher(node: Node, kind: type, topic: str, depth: int) -> Publisher:
    """Return a publisher whose quality of service can be overridden by parameters; reliable by default."""
    overridable = QoSOverridingOptions.with_default_policies()
    return node.create_publisher(kind, topic, QoSProfile(depth=depth), qos_overriding_options=overridable)


def set_header(header: Any, stamp_ns: int, frame: bytes) -> None:
    """Set stamp [ns] and frame id (UTF-8) of a std_msgs/Header."""
    header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    header.frame_id = frame.decode("utf-8", "replace")


class EstimateOutput:
    """Publishers of a joint's estimates on `topic`, and of the bounds of their bands on `topic`_band.

    `has_band_listeners` says whether bands are heard, which is checked every CHECK_NS; others are not published.
    """

    def __init__(self, node: Node, joint: str, topic: str) -> None:
        self._node = node
        self._estimates, self._bands = (
            create_publisher(node, JointState, name, OUTPUT_DEPTH) for name in (topic, f"{topic}_band")
        )
        self._estimate = JointState(name=[joint], position=[0.0], velocity=[0.0], effort=[0.0])
        self._band = JointState(name=[f"{joint}_lower", f"{joint}_upper"], effort=[0.0, 0.0])
        self.has_band_listeners, self._checked_ns = True, 0

    def publish(
        self, stamp_ns: int, frame: bytes, position: float, speed: float, force: float, half_width: float | None
    ) -> None:
        """Publish an estimate [m, m/s, N], and its band if the half-width [N] is known."""
        message = self._estimate
        set_header(message.header, stamp_ns, frame)
        message.position[0], message.velocity[0], message.effort[0] = position, speed, force
        self._estimates.publish(message)
        if not 0 <= stamp_ns - self._checked_ns < CHECK_NS:
            self.has_band_listeners, self._checked_ns = self._bands.get_subscription_count() > 0, stamp_ns
        if half_width is not None and self.has_band_listeners:
            self._band.header = message.header
            self._band.effort[0], self._band.effort[1] = force - half_width, force + half_width
            self._bands.publish(self._band)

    def close(self) -> None:
        """Withdraw both topics."""
        for publisher in (self._estimates, self._bands):
            self._node.destroy_publisher(publisher)


class CommandOutput:
    """Publisher of currents on `valve_command`; only the newest counts, so the queue holds one.

    It publishes the reachable desired force, too, on `~/desired_force`, which costs nothing without subscribers.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._commands = create_publisher(node, Float64, "valve_command", 1)
        self._desired = create_publisher(node, WrenchStamped, "~/desired_force", 10)
        self._command, self._wrench = Float64(), WrenchStamped()

    def close(self) -> None:
        """Withdraw both topics."""
        for publisher in (self._commands, self._desired):
            self._node.destroy_publisher(publisher)

    def publish(self, current_A: float) -> None:
        """Publish a current [A]."""
        self._command.data = current_A
        self._commands.publish(self._command)

    def publish_desired(self, stamp_ns: int, frame: bytes, force_N: float) -> None:
        """Publish the force [N] with the estimate's stamp and frame."""
        if self._desired.get_subscription_count() > 0:
            set_header(self._wrench.header, stamp_ns, frame)
            self._wrench.wrench.force.z = force_N
            self._desired.publish(self._wrench)


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
