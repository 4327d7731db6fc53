"""Messages of many types with the path to a number in each, and readers of them."""

from __future__ import annotations

from cdr_messages import define, fields_of, header, message

from ces_observer.cdr.signal import RawSignal
from ces_observer.signals import FieldPath, Signal

JOINTS = "sensor_msgs/msg/JointState"
STAMP = 1_700_000_000_123_456_789
define("damper_msgs/msg/Coil", "string<=10 label\nfloat32 amperes\nint64[2] counts\nbool on")
define("damper_msgs/msg/Nothing", "")
define("damper_msgs/msg/Phased", "uint8 a\nuint16 b\nuint8 c")
define(
    "damper_msgs/msg/Valve",
    "std_msgs/Header header\nuint8 mode\nstring[2] labels\ndamper_msgs/Nothing[] nothings\n"
    "damper_msgs/Phased[] phased\ndamper_msgs/Coil[<=3] coils\nstring<=4[<=2] short\nfloat64[] values\n"
    "string[] joint_names\nint16 last",
)
define("damper_msgs/msg/Late", "float64 value\nstd_msgs/Header header\nfloat64 data")
define("damper_msgs/msg/Named", "string name\nfloat64[] values")


def signal(kind, path, scale=1.0, offset=0.0):
    return Signal("position", "topic", kind, FieldPath.parse(path), scale, offset)


def reader(kind, path, **more):
    return RawSignal(signal(kind, path, **more), fields_of)


def joints(names, positions, stamp_ns=STAMP, frame_id="", **more):
    return message("sensor_msgs/JointState", header=header(stamp_ns, frame_id), name=names, position=positions, **more)


def vector(x, y, z):
    return message("geometry_msgs/Vector3", x=x, y=y, z=z)


def wrench(z):
    both = message("geometry_msgs/Wrench", force=vector(1.0, 2.0, z), torque=vector(3.0, 4.0, 5.0))
    return message("geometry_msgs/WrenchStamped", header=header(STAMP, "rig"), wrench=both)


def trajectory():
    points = [
        message("trajectory_msgs/JointTrajectoryPoint", positions=[1.0 + i, 2.0 + i], effort=[7.0 + i])
        for i in range(3)
    ]
    return message("trajectory_msgs/JointTrajectory", header=header(1), joint_names=["a", "b", "c"], points=points)


def valve(nothings=2, phased=5):
    coils = [message("damper_msgs/Coil", label=f"c{i}", amperes=0.5 + i, counts=[-(2**40), i], on=True) for i in (0, 1)]
    return message(
        "damper_msgs/Valve",
        header=header(STAMP, "hydraulics"),
        labels=["left", ""],
        nothings=[message("damper_msgs/Nothing") for _ in range(nothings)],
        phased=[message("damper_msgs/Phased", a=1, b=i, c=3) for i in range(phased)],
        coils=coils,
        short=["abcd"],
        values=[0.25, 0.5],
        joint_names=["fork", "rear"],
        last=-7,
    )


POINTS = message(
    "sensor_msgs/PointCloud",
    header=header(3),
    points=[message("geometry_msgs/Point32", x=float(i)) for i in range(500)],
    channels=[message("sensor_msgs/ChannelFloat32", name="rgb", values=[4.5, 5.5])],
)
READABLE = [
    (message("std_msgs/Float64", data=-2.5), "data"),
    (message("std_msgs/Float32", data=-2.5), "data"),
    (message("std_msgs/Bool", data=True), "data"),
    (message("std_msgs/Int8", data=-5), "data"),
    (message("std_msgs/UInt64", data=2**63 + 1), "data"),
    (message("std_msgs/Float64MultiArray", data=[1.0, 2.0, 3.0]), "data[2]"),
    (joints(["rear", "fork"], [0.1, 0.2]), "position[rear]"),
    (joints(["rear", "fork"], [0.1, 0.2], frame_id="base"), "position[fork]"),
    (joints(["rear", "fork"], [0.1], effort=[5.0, 6.0]), "effort[fork]"),
    (joints(["dämpfer", "rear", "rear"], [0.1, 0.2, 0.3]), "position[rear]"),
    (joints([], [0.1, 0.2]), "position[1]"),
    (wrench(-300.0), "wrench.force.z"),
    (wrench(-300.0), "wrench.torque.y"),
    (message("sensor_msgs/Temperature", header=header(STAMP, "oil"), temperature=71.5), "temperature"),
    (message("sensor_msgs/Imu", header=header(1), linear_acceleration=vector(1.0, 2.0, 9.8)), "linear_acceleration.z"),
    (message("sensor_msgs/Imu", header=header(1), orientation_covariance=range(9)), "orientation_covariance[7]"),
    (message("nav_msgs/Odometry", header=header(STAMP), child_frame_id="wheel"), "twist.twist.linear.x"),
    (trajectory(), "points[2].positions[1]"),
    (trajectory(), "points[b].effort[0]"),
    (POINTS, "points[432].x"),
    (POINTS, "channels[0].values[1]"),
    (valve(), "mode"),
    (valve(), "coils[1].amperes"),
    (valve(), "coils[rear].counts[0]"),  # the joints' names come after the coils
    (valve(), "values[rear]"),
    (valve(0, 0), "values[fork]"),
    (valve(1, 3), "last"),
    (valve(7, 1000), "phased[998].b"),
    (valve(3, 11), "coils[0].on"),
]  # fmt: skip
