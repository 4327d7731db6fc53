"""Raw messages of a damper's topics for tests, serialised by rosbags, and a channel for each topic."""

from __future__ import annotations

from math import pi, sin

import numpy as np
from rosbags.typesys import Stores, get_typestore

from ces_observer.recorder.mcap_file import BagChannel
from ces_observer.recorder.message_definition import message_definition

JAZZY = get_typestore(Stores.ROS2_JAZZY)
TYPES = JAZZY.types
SECOND = 1_000_000_000
MS = 1_000_000
JOINTS, FLOAT, WRENCH = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64", "geometry_msgs/msg/WrenchStamped"
POSITION, CURRENT, FORCE, ESTIMATE = range(4)
TOPICS = (
    ("/joint_states", JOINTS),
    ("/valve_current", FLOAT),
    ("/measured_force", WRENCH),
    ("/observer/estimate", JOINTS),
)


def msg_text(name: str) -> str:
    """Return the .msg text of one type alone, as rosbags knows it."""
    return JAZZY.generate_msgdef(name, ros_version=2)[0].partition("=" * 80)[0]


def channels() -> list[BagChannel]:
    return [
        BagChannel(topic, kind, message_definition(kind, msg_text), JAZZY.hash_rihs01(kind)) for topic, kind in TOPICS
    ]


def raw_position(stamp_ns: int, position_m: float) -> bytes:
    empty = np.zeros(0)
    return raw(JOINTS, TYPES[JOINTS](header(stamp_ns), ["rear_damper"], np.array([position_m]), empty, empty))


def raw_estimate(stamp_ns: int, position_m: float, speed: float, force_N: float) -> bytes:
    arrays = (np.array([value]) for value in (position_m, speed, force_N))
    return raw(JOINTS, TYPES[JOINTS](header(stamp_ns), ["rear_damper"], *arrays))


def raw_current(current_A: float) -> bytes:
    return raw(FLOAT, TYPES[FLOAT](current_A))


def raw_force(stamp_ns: int, force_N: float) -> bytes:
    vector = TYPES["geometry_msgs/msg/Vector3"]
    wrench = TYPES["geometry_msgs/msg/Wrench"](vector(0.0, 0.0, force_N), vector(0.0, 0.0, 0.0))
    return raw(WRENCH, TYPES[WRENCH](header(stamp_ns), wrench))


def drive(start_ns: int, seconds: float) -> list[tuple[int, int, bytes]]:
    """Return (channel, arrival, message) of a damper stroked at 2 Hz and 1 kHz, its current at 200 Hz."""
    messages = []
    for k in range(round(seconds * 1000)):
        stamp, phase = start_ns + k * MS, 2.0 * pi * 2.0 * k * 1e-3
        messages.append((POSITION, stamp + 150_000, raw_position(stamp, 0.02 * sin(phase))))
        if k % 5 == 0:
            messages.append((CURRENT, stamp + 200_000, raw_current(0.5)))
        messages.append((ESTIMATE, stamp + 300_000, raw_estimate(stamp, 0.02 * sin(phase), 0.1, 400.0 * sin(phase))))
        messages.append((FORCE, stamp + 400_000, raw_force(stamp, 500.0 * sin(phase))))
    return messages


def header(stamp_ns: int) -> object:
    time = TYPES["builtin_interfaces/msg/Time"](stamp_ns // SECOND, stamp_ns % SECOND)
    return TYPES["std_msgs/msg/Header"](time, "chassis")


def raw(kind: str, message: object) -> bytes:
    return bytes(JAZZY.serialize_cdr(message, kind))
