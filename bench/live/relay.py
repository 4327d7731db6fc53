"""An empty relay in Python, the minimum cost of an rclpy node: it publishes each JointState that it receives.

Usage: python relay.py single|events|raw|both --ros-args -r __ns:=/NAMESPACE. `single` is rclpy.spin, `events` the
EventsExecutor, both with ordinary messages; `raw` is the EventsExecutor with the bytes passed on unchanged and the
cyclic garbage collector off; `both` also receives the valve current, as the observer must, without using it.
"""

from __future__ import annotations

import gc
import signal
import sys
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

INPUT = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.BEST_EFFORT)  # as in the observer
OUTPUT = QoSProfile(depth=10)
RAW = ("raw", "both")


def relay(kind: str) -> Node:
    node = Node("relay")
    publisher = node.create_publisher(JointState, "~/estimate", OUTPUT)
    node.create_subscription(JointState, "joint_states", publisher.publish, INPUT, raw=kind in RAW)
    if kind == "both":
        node.create_subscription(Float64, "valve_current", lambda message: None, INPUT, raw=True)
    return node


def main() -> None:
    kind = sys.argv[1]
    signal.signal(signal.SIGINT, lambda number, frame: None)  # rclpy shuts down by itself
    rclpy.init()
    executor = SingleThreadedExecutor() if kind == "single" else EventsExecutor()
    executor.add_node(relay(kind))
    if kind in RAW:
        gc.collect()
        gc.freeze()
        gc.disable()
    with suppress(ExternalShutdownException):
        executor.spin()


if __name__ == "__main__":
    main()
