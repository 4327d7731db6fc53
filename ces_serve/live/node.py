"""The process that listens to running observers: topics of ROS 2 in, lines of JSON on standard output.

It subscribes to every estimate and band that it finds, and to /diagnostics, as best effort, so that it hears any
publisher and slows none down. It publishes nothing, and ends when its standard input closes.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from contextlib import suppress
from math import isfinite
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from ces_observer.nodes.executors import AUTO, make_executor
from ces_serve.live.batches import EstimateBatches

SEND_S, SEARCH_S = 0.05, 1.0
ESTIMATE, BAND = "/estimate", "_band"
JOINT_STATE = "sensor_msgs/msg/JointState"
QUEUE = 1000  # messages: a second at 1 kHz
LISTEN = QoSProfile(depth=QUEUE, reliability=QoSReliabilityPolicy.BEST_EFFORT)


class ObserverListener(Node):  # type: ignore[misc]
    """Listens to the observer whose node has the full name `observer`, or to all if that is empty."""

    def __init__(self, observer: str) -> None:
        # Neither logs on /rosout nor services: nothing of this node is to appear on the vehicle but its subscriptions.
        super().__init__(f"ces_serve_{os.getpid()}", enable_rosout=False, start_parameter_services=False)
        self._observer = f"/{observer.strip('/')}" if observer else ""
        self._batches: dict[str, EstimateBatches] = {}
        self._publishers: set[str] = set()  # names of the nodes behind the estimates
        self._offered: list[str] | None = None
        self.create_subscription(DiagnosticArray, "/diagnostics", self._hear_diagnostics, LISTEN)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(SEARCH_S, self._search, clock=steady)
        self.create_timer(SEND_S, self._send_batches, clock=steady)
        self._search()

    def _search(self) -> None:
        """Subscribe to estimates that are new, and say which are offered now."""
        offered = []
        for topic, types in self.get_topic_names_and_types():
            if topic.endswith(ESTIMATE) and JOINT_STATE in types and self._has_publisher(topic):
                offered.append(topic)
                if topic not in self._batches:
                    self._subscribe(topic)
        if offered != self._offered:
            self._offered = offered
            send({"topics": offered})

    def _has_publisher(self, topic: str) -> bool:
        """Return whether an observer that is wanted publishes `topic`; a player of bags may do so in its place."""
        infos = self.get_publishers_info_by_topic(topic)
        nodes = {f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos}
        if self._observer and not topic.startswith(f"{self._observer}/"):
            nodes &= {self._observer}
        self._publishers |= nodes
        return bool(nodes)

    def _is_observer(self, node: str) -> bool:
        """Return whether the status of `node` is that of an observer whose estimates are heard."""
        if self._observer:
            return node == self._observer
        return node in self._publishers or any(topic.startswith(f"{node}/") for topic in self._batches)

    def _subscribe(self, topic: str) -> None:
        batches = self._batches[topic] = EstimateBatches()

        def hear_estimate(message: JointState) -> None:
            if len(message.position) == len(message.velocity) == len(message.effort) == 1:
                numbers = (message.position[0], message.velocity[0], message.effort[0])
                if all(map(isfinite, numbers)):
                    batches.add_estimate(_stamp_ns(message), *numbers)

        def hear_band(message: JointState) -> None:
            if len(message.effort) == 2 and all(map(isfinite, message.effort)):
                batches.add_band(_stamp_ns(message), *message.effort)

        self.create_subscription(JointState, topic, hear_estimate, LISTEN)
        self.create_subscription(JointState, topic + BAND, hear_band, LISTEN)

    def _hear_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if not self._is_observer(status.name.partition(":")[0]):
                continue
            values = {value.key: value.value for value in status.values}
            level = int.from_bytes(status.level, "little")
            send({"status": {"name": status.name, "level": level, "message": status.message, "values": values}})

    def _send_batches(self) -> None:
        for topic, batches in self._batches.items():
            batch = batches.take()
            if batch is not None:
                send({"topic": topic, "batch": batch})


def send(message: dict[str, Any]) -> None:
    """Write a line; the process ends if nobody reads it."""
    try:
        sys.stdout.write(json.dumps(message) + "\n")
        sys.stdout.flush()
    except OSError:
        os._exit(0)


def main(argv: list[str]) -> int:
    """Listen until the standard input closes; `argv` is the observer's name, or empty."""
    threading.Thread(target=_exit_with_server, daemon=True).start()
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    executor = make_executor(AUTO)
    executor.add_node(ObserverListener(argv[0] if argv else ""))
    with suppress(ExternalShutdownException):
        executor.spin()
    return 0


def _stamp_ns(message: JointState) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def _exit_with_server() -> None:
    os.read(sys.stdin.fileno(), 1)
    os._exit(0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
