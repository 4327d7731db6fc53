"""Time to read a signal from a message's bytes and to write an estimate, compared with rclpy.

Usage: python bench/bench_raw_messages.py. With ROS 2 sourced (and its own python3) the columns of rclpy are there too:
deserialising the message and following the field path, filling a kept message in and serialising it. Medians of
turns that take each work once, in CPU time.
"""

from __future__ import annotations

from functools import partial
from timeit import Timer
from typing import Any

import numpy as np
from measurement import print_note, print_table, time_interleaved, verdict
from rosbags.typesys import Stores, get_typestore

from ces_observer.cdr.joint_state import RawEstimate
from ces_observer.cdr.signal import RawSignal
from ces_observer.signals import FieldPath, Signal

CALLS = 20_000
REPEATS = 15
STAMP_NS = 1_700_000_000_123_456_789
STORE = get_typestore(Stores.ROS2_JAZZY)
FIELDS = {
    "builtin_interfaces/Time": {"sec": "int32", "nanosec": "uint32"},
    "std_msgs/Header": {"stamp": "builtin_interfaces/Time", "frame_id": "string"},
    "std_msgs/msg/Float64": {"data": "double"},
    "sensor_msgs/msg/JointState": {
        "header": "std_msgs/Header",
        "name": "sequence<string>",
        "position": "sequence<double>",
        "velocity": "sequence<double>",
        "effort": "sequence<double>",
    },
    "geometry_msgs/Vector3": {"x": "double", "y": "double", "z": "double"},
    "geometry_msgs/Wrench": {"force": "geometry_msgs/Vector3", "torque": "geometry_msgs/Vector3"},
    "geometry_msgs/msg/WrenchStamped": {"header": "std_msgs/Header", "wrench": "geometry_msgs/Wrench"},
}
JOINTS, FLOAT, WRENCH = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64", "geometry_msgs/msg/WrenchStamped"
READS = {  # type, field, target [µs] if there is one
    "read Float64, data": (FLOAT, "data", 0.3),
    "read WrenchStamped, wrench.force.z": (WRENCH, "wrench.force.z", 0.6),
    "read JointState of 2, position[rear_damper]": (JOINTS, "position[rear_damper]", 0.6),
    "read JointState of 2, effort[rear_damper]": (JOINTS, "effort[rear_damper]", None),
}
WRITE, WRITE_TARGET = "write JointState of 1", 0.5
ESTIMATE: dict[str, Any] = {
    "stamp_ns": STAMP_NS,
    "frame_id": "base_link",
    "position": 0.01,
    "speed": -0.2,
    "force": 350.0,
}


def main() -> None:
    works = {f"raw {name}": work for name, work in raw_works().items()}
    works |= {f"rclpy {name}": work for name, work in rclpy_works().items()}
    seconds = time_interleaved({name: partial(work.timeit, CALLS) for name, work in works.items()}, REPEATS)
    us = {name: 1e6 * time / CALLS for name, time in seconds.items()}
    targets = {name: target for name, (_, _, target) in READS.items()} | {WRITE: WRITE_TARGET}
    rows = [row(name, us[f"raw {name}"], target, us.get(f"rclpy {name}")) for name, target in targets.items()]
    print_table(("work", "from or to bytes [µs]", "target [µs]", "verdict", "rclpy [µs]", "times"), rows)


def row(name: str, raw: float, target: float | None, ordinary: float | None) -> list[str]:
    aim = ["–", "–"] if target is None else [f"{target:.1f}", verdict(raw, target)]
    beside = ["–", "–"] if ordinary is None else [f"{ordinary:.2f}", f"{ordinary / raw:.0f}"]
    return [name, f"{raw:.2f}", *aim, *beside]


def raw_works() -> dict[str, Timer]:
    works: dict[str, Timer] = {}
    for name, (kind, field, _) in READS.items():
        reader = RawSignal(Signal("position", "t", kind, FieldPath.parse(field)), FIELDS.__getitem__)
        works[name] = Timer("read(raw)", globals={"read": reader.read, "raw": serialise(kind)})
    estimate = {**ESTIMATE, "frame_id": ESTIMATE["frame_id"].encode(), "fill": RawEstimate("rear_damper").fill}
    works[WRITE] = Timer("fill(stamp_ns, frame_id, position, speed, force)", globals=estimate)
    return works


def rclpy_works() -> dict[str, Timer]:
    try:
        from rclpy.serialization import deserialize_message, serialize_message
        from rosidl_runtime_py.utilities import get_message
    except ImportError:
        print_note("ROS 2 is not sourced: the columns of rclpy are left out")
        return {}
    from ces_observer.nodes.message_types import header_stamp_ns, is_stamped

    works: dict[str, Timer] = {}
    for name, (kind, field, _) in READS.items():
        raw, of_type, read = serialise(kind), get_message(kind), FieldPath.parse(field).read
        names = {
            "raw": raw,
            "kind": of_type,
            "read": read,
            "deserialise": deserialize_message,
            "stamp": header_stamp_ns,
        }
        stamp = "; stamp(message)" if is_stamped(of_type) else ""
        works[name] = Timer(f"message = deserialise(raw, kind); read(message){stamp}", globals=names)
    message = get_message(JOINTS)(name=["rear_damper"], position=[0.0], velocity=[0.0], effort=[0.0])
    names = {"write": write_ordinarily, "message": message, "serialise": serialize_message, "estimate": ESTIMATE}
    works[WRITE] = Timer("write(message, **estimate); serialise(message)", globals=names)
    return works


def write_ordinarily(message: Any, stamp_ns: int, frame_id: str, position: float, speed: float, force: float) -> None:
    header = message.header
    header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    header.frame_id = frame_id
    message.position[0], message.velocity[0], message.effort[0] = position, speed, force


def serialise(kind: str) -> bytes:
    """Return a message of one of the types in READS."""
    types = STORE.types
    sec, nanosec = divmod(STAMP_NS, 1_000_000_000)
    stamp = types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="base_link")
    vector = types["geometry_msgs/msg/Vector3"](x=1.0, y=2.0, z=3.0)
    two = np.array([0.1, 0.2])
    fields: dict[str, dict[str, Any]] = {
        FLOAT: {"data": 0.7},
        WRENCH: {"header": header, "wrench": types["geometry_msgs/msg/Wrench"](force=vector, torque=vector)},
        JOINTS: {"header": header, "name": ["front_damper", "rear_damper"]}
        | {"position": two, "velocity": two, "effort": two},
    }
    return bytes(STORE.serialize_cdr(types[kind](**fields[kind]), kind))


if __name__ == "__main__":
    main()
