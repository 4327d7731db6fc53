"""Heartbeats of an active node for a lifecycle manager that keeps a bond with it (ros/bond_core), as nav2's does."""

from __future__ import annotations

from time import monotonic
from typing import Any
from uuid import uuid4

from rclpy.node import Node
from rosidl_runtime_py.utilities import get_message

TIMEOUT_S = 4.0  # of nav2's nodes; the manager has its own
SLACK_S = 0.05  # half the period of the timer that looks whether one is due


class Bond:
    """Says on `bond` that the node lives, between `open` and `close`; never without the package `bond`."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher: Any = None

    def open(self, period_s: float) -> None:
        """Begin with heartbeats every `period_s` [s]; none with 0."""
        try:
            kind = get_message("bond/msg/Status")
        except (ImportError, AttributeError):
            return
        if period_s > 0.0:
            self._message = kind(id=self._node.get_name(), instance_id=str(uuid4()), active=True)
            self._message.heartbeat_period, self._message.heartbeat_timeout = period_s, TIMEOUT_S
            self._publisher, self._told_s = self._node.create_publisher(kind, "bond", 10), 0.0

    def watch(self) -> None:
        """Publish a heartbeat if it is due."""
        if self._publisher is not None and monotonic() - self._told_s >= self._message.heartbeat_period - SLACK_S:
            self._told_s = monotonic()
            self._message.header.stamp = self._node.get_clock().now().to_msg()
            self._publisher.publish(self._message)

    def close(self) -> None:
        """Break the bond."""
        if self._publisher is not None:
            self._message.active, self._told_s = False, 0.0
            self.watch()
            self._node.destroy_publisher(self._publisher)
            self._publisher = None
