"""An empty relay in Python, the least that an rclpy node with the observer's inputs costs.

Usage: python relay.py --ros-args -r __ns:=/NAMESPACE. It publishes the bytes of each JointState that it receives and
receives the valve current without using it, by the EventsExecutor and with the cyclic garbage collector off.
"""

from __future__ import annotations

import gc
import signal
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

INPUT = QoSProfile(depth=5000, reliability=QoSReliabilityPolicy.BEST_EFFORT)  # as in the observer
OUTPUT = QoSProfile(depth=1000)


def relay() -> Node:
    node = Node("relay")
    publisher = node.create_publisher(JointState, "~/estimate", OUTPUT)
    node.create_subscription(JointState, "joint_states", publisher.publish, INPUT, raw=True)
    node.create_subscription(Float64, "valve_current", lambda message: None, INPUT, raw=True)
    return node


def main() -> None:
    signal.signal(signal.SIGINT, lambda number, frame: None)  # rclpy shuts down by itself
    rclpy.init()
    executor = EventsExecutor()
    executor.add_node(relay())
    gc.collect()
    gc.freeze()
    gc.disable()
    with suppress(ExternalShutdownException):
        executor.spin()


if __name__ == "__main__":
    main()
