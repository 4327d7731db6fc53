"""Qualities of service that both ends of a topic must agree on."""

from __future__ import annotations

from rclpy.qos import QoSDurabilityPolicy, QoSProfile

LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)  # late subscribers get the newest
