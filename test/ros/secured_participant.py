"""A participant with the rights of its environment: drives position and current, or hears estimates, or does both.

A process of its own, as the environment sets its security. It ends after a time, or before when it has heard enough
estimates or a file has come. Prints one JSON line: how many estimates it heard, and the most subscriptions that its
position matched at a time.
"""

from __future__ import annotations

import json
import sys
import time
from math import inf, sin
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

PERIOD_S = 0.002
STROKE_M, RAD_S = 0.02, 12.0


class Drive:
    """Publishes a sine of position and a steady current; `matched` counts subscriptions."""

    def __init__(self, node: Node) -> None:
        self._clock = node.get_clock()
        self._position = node.create_publisher(JointState, "joint_states", QoSProfile(depth=10))
        self._current = node.create_publisher(Float64, "valve_current", QoSProfile(depth=10))
        self.matched = 0

    def publish(self) -> None:
        message = JointState(name=["rear_damper"], position=[STROKE_M * sin(RAD_S * time.monotonic())])
        message.header.stamp = self._clock.now().to_msg()
        self._current.publish(Float64(data=0.5))
        self._position.publish(message)
        self.matched = max(self.matched, self._position.get_subscription_count())


def main(role: str, duration_s: float, enough: float = inf, stop: Path | None = None) -> None:
    rclpy.init()
    node = rclpy.create_node("participant")
    heard: list[JointState] = []
    if role in ("hear", "both"):
        node.create_subscription(JointState, "observer/estimate", heard.append, qos_profile_sensor_data)
    drive = Drive(node) if role in ("drive", "both") else None
    end = time.monotonic() + duration_s
    while time.monotonic() < end and len(heard) < enough and not (stop and stop.exists()):
        rclpy.spin_once(node, timeout_sec=PERIOD_S)
        if drive is not None:
            drive.publish()
    print(json.dumps({"heard": len(heard), "matched": drive.matched if drive else 0}))


if __name__ == "__main__":
    _, asked_role, *numbers = remove_ros_args(sys.argv)
    main(asked_role, *map(float, numbers[:2]), *map(Path, numbers[2:]))
