"""An empty relay in Python, the least that an rclpy node can cost: each JointState that comes in goes out again.

Usage: python relay.py single|events|raw|both --ros-args -r __ns:=/NAMESPACE. `single` is rclpy.spin, `events` the
EventsExecutor, both with ordinary messages; `raw` is the EventsExecutor with the bytes handed on as they are and the
cyclic garbage collector off; `both` hears the valve current besides, as the observer must, and does nothing with it.
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

INPUT = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.BEST_EFFORT)  # as the observer has it
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
