"""Tiny bags and messages for tests, written one message at a time by rosbags itself."""

from __future__ import annotations

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

JAZZY = get_typestore(Stores.ROS2_JAZZY)
TYPES = JAZZY.types
SECOND = 1_000_000_000

JOINTS, FLOAT, WRENCH = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64", "geometry_msgs/msg/WrenchStamped"
VALVE = "damper_msgs/msg/Valve"
VALVE_TEXT = (
    "std_msgs/Header header\nstring mode\nuint8[] flags\nCoil[] coils\n"
    + "=" * 80
    + ("\nMSG: damper_msgs/Coil\nstring<=10 label\nfloat32 amperes\n")
)


def with_valve():
    """The Jazzy types and a custom one."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(VALVE_TEXT, VALVE))
    return store


def header(stamp_ns, frame=""):
    time = TYPES["builtin_interfaces/msg/Time"](sec=stamp_ns // SECOND, nanosec=stamp_ns % SECOND)
    return TYPES["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def joints(stamp_ns, names, positions, frame="", efforts=()):
    return TYPES[JOINTS](
        header=header(stamp_ns, frame),
        name=list(names),
        position=np.array(positions, dtype=np.float64),
        velocity=np.zeros(0),
        effort=np.array(efforts, dtype=np.float64),
    )


def number(value):
    return TYPES[FLOAT](data=value)


def wrench(stamp_ns, fz, frame=""):
    vector = TYPES["geometry_msgs/msg/Vector3"]
    both = TYPES["geometry_msgs/msg/Wrench"](force=vector(x=1.0, y=2.0, z=fz), torque=vector(x=0.0, y=0.0, z=0.0))
    return TYPES[WRENCH](header=header(stamp_ns, frame), wrench=both)


def write(path, streams, storage=StoragePlugin.MCAP, compression=CompressionMode.NONE, store=JAZZY, little_endian=True):
    """Write `streams`, a list of (topic, type, [(log time [ns], message), ...]), in the order given."""
    writer = Writer(path, version=9, storage_plugin=storage)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        for topic, kind, messages in streams:
            connection = writer.add_connection(topic, kind, typestore=store)
            for log_ns, message in messages:
                raw = store.serialize_cdr(message, kind, little_endian=little_endian)
                writer.write(connection, log_ns, raw)
    return path


def drive(n=50, period_ns=1_000_000, start_ns=5 * SECOND, late_ns=300):
    """Position, current and force of n samples each, logged `late_ns` after their stamps."""
    times = [start_ns + i * period_ns for i in range(n)]
    return [
        (
            "/joint_states",
            JOINTS,
            [(t + late_ns, joints(t, ["rear_damper"], [0.001 * i])) for i, t in enumerate(times)],
        ),
        ("/valve_current", FLOAT, [(t + late_ns, number(0.3 + 0.01 * i)) for i, t in enumerate(times)]),
        ("/measured_force", WRENCH, [(t + late_ns, wrench(t, 10.0 * i)) for i, t in enumerate(times)]),
    ]
