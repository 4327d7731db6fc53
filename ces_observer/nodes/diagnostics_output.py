"""The topic /diagnostics: statuses of dampers in, one DiagnosticArray out; new reasons are logged."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from time import monotonic
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from ces_observer.health.health import LEVEL_OK, LEVEL_WARN, Status

LOG_S = 1.0  # minimum time between two lines on one damper, against floods by a flickering reason


class DamperReport(NamedTuple):
    """The status of a damper, with its name in diagnostics, its joint, and "ok" or why its force is withheld."""

    damper: str
    joint: str
    reason: str
    status: Status


def add_remark(status: Status, remark: str) -> Status:
    """Return the status as a warning with `remark` added to its message; unchanged without one."""
    if not remark:
        return status
    return Status(max(status.level, LEVEL_WARN), f"{status.message}; {remark}", status.values)


class DiagnosticsOutput:
    """Publisher of statuses."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._logged: dict[str, tuple[str, float]] = {}

    def publish(self, reports: Sequence[DamperReport]) -> None:
        """Publish the status of each damper in one message, and log new reasons."""
        message = DiagnosticArray(status=[self._diagnostic(report) for report in reports])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)
        for report in reports:
            self._log(report)

    def _diagnostic(self, report: DamperReport) -> DiagnosticStatus:
        status = report.status
        return DiagnosticStatus(
            level=bytes([status.level]),
            name=f"{self._node.get_fully_qualified_name()}: {report.damper}",
            message=status.message,
            hardware_id=report.joint,
            values=[KeyValue(key=key, value=value) for key, value in status.values],
        )

    def _log(self, report: DamperReport) -> None:
        known, at = self._logged.get(report.damper, ("", -inf))
        now = monotonic()
        if report.reason == known or now - at < LOG_S:
            return
        self._logged[report.damper] = report.reason, now
        if report.status.level == LEVEL_OK:
            self._node.get_logger().info(f"{report.damper}: {report.status.message}")
        else:
            self._node.get_logger().warning(f"{report.damper}: {report.status.message}")
