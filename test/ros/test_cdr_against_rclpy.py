"""Raw reading against what rclpy serialises with the middleware that is installed."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3, Wrench, WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import ChannelFloat32, Imu, JointState, PointCloud, Temperature
from std_msgs.msg import Bool, Byte, Float32, Float64, Float64MultiArray, Header, Int64, MultiArrayDimension, String
from std_msgs.msg import MultiArrayLayout as ArrayLayout
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ces_observer.cdr.layout import CdrUnsupportedError
from ces_observer.cdr.signal import RawSignal
from ces_observer.errors import SignalsError
from ces_observer.nodes.inputs import fields_of, header_stamp_ns, is_stamped
from ces_observer.signals import FieldPath, Signal

STAMP_NS = 1_700_000_000_123_456_789


def header(frame_id=""):
    stamped = Header(frame_id=frame_id)
    stamped.stamp.sec, stamped.stamp.nanosec = divmod(STAMP_NS, 1_000_000_000)
    return stamped


def joints(*names, frame_id="", **arrays):
    return JointState(header=header(frame_id), name=list(names), **arrays)


TRAJECTORY = JointTrajectory(
    header=header("map"),
    joint_names=["fork", "rear"],
    points=[JointTrajectoryPoint(positions=[1.0, 2.0]), JointTrajectoryPoint(positions=[3.0], effort=[4.0, 5.0])],
)
TABLE = Float64MultiArray(layout=ArrayLayout(dim=[MultiArrayDimension(label="row", size=2)] * 3), data=[1.5, 2.5])
CLOUD = PointCloud(
    header=header(), channels=[ChannelFloat32(name="i", values=[1.0]), ChannelFloat32(values=[2.0, 3.0])]
)
FORCE = Wrench(force=Vector3(x=1.0, y=2.0, z=-350.5), torque=Vector3(x=7.0))
READABLE = [
    (Float64(data=0.7), "data"),
    (Float64(data=float("-inf")), "data"),
    (Float32(data=0.5), "data"),
    (Int64(data=-(2**62)), "data"),
    (Bool(data=True), "data"),
    (TABLE, "data[1]"),
    (TABLE, "layout.dim[2].size"),
    (joints("rear", position=[0.1]), "position[rear]"),
    (joints("fork", "rear", position=[0.1, 0.2], frame_id="base_link"), "position[rear]"),
    (joints("fork", "réar", "rear", position=[0.1, 0.2, 0.3], effort=[4.0, 5.0, 6.0]), "effort[rear]"),
    (WrenchStamped(header=header("rig"), wrench=FORCE), "wrench.force.z"),
    (Temperature(header=header("oil"), temperature=70.5, variance=0.1), "variance"),
    (Imu(header=header("imu"), linear_acceleration=Vector3(z=9.8)), "linear_acceleration.z"),
    (Imu(header=header(), orientation_covariance=[float(i) for i in range(9)]), "orientation_covariance[8]"),
    (Odometry(header=header(), child_frame_id="wheel"), "twist.covariance[35]"),
    (TRAJECTORY, "points[1].effort[0]"),
    (TRAJECTORY, "points[rear].positions[0]"),
    (CLOUD, "channels[1].values[1]"),
]


def reader(message, path):
    package, _, _ = type(message).__module__.partition(".")
    return RawSignal(
        Signal("position", "t", f"{package}/msg/{type(message).__name__}", FieldPath.parse(path)), fields_of
    )


@pytest.mark.parametrize(("message", "path"), READABLE, ids=[f"{type(m).__name__}-{path}" for m, path in READABLE])
def test_raw_reading_is_that_of_the_message(message, path):
    raw = serialize_message(message)
    stamped = is_stamped(type(message))
    asked = reader(message, path)
    expected = (
        header_stamp_ns(message) if stamped else None,
        FieldPath.parse(path).read(deserialize_message(raw, type(message))),
        message.header.frame_id.encode() if stamped else b"",
    )
    assert asked.stamped is stamped
    assert [asked.read(raw) for _ in range(2)] == [expected] * 2


@pytest.mark.parametrize(
    ("message", "path"),
    [
        (joints("fork", position=[0.1]), "position[rear]"),
        (JointState(), "position[rear]"),
        (joints("fork", "rear", position=[0.1]), "position[rear]"),
        (TRAJECTORY, "points[fork].effort[0]"),
    ],
)
def test_what_is_missing_is_told_as_ever(message, path):
    with pytest.raises(SignalsError) as told:
        FieldPath.parse(path).read(message)
    with pytest.raises(SignalsError) as told_raw:
        reader(message, path).read(serialize_message(message))
    assert str(told_raw.value) == str(told.value)


@pytest.mark.parametrize(
    ("message", "path"), [(String(), "data"), (Byte(), "data"), (DiagnosticArray(), "status[0].level")]
)
def test_what_is_no_plain_number_is_left_to_rclpy(message, path):
    with pytest.raises(CdrUnsupportedError):
        reader(message, path)


def test_type_that_is_not_installed_is_left_to_rclpy():
    with pytest.raises(LookupError):
        fields_of("no_msgs/msg/Such")
    with pytest.raises(CdrUnsupportedError, match="the fields of 'no_msgs/msg/Such' are not known"):
        RawSignal(Signal("position", "t", "no_msgs/msg/Such", FieldPath.parse("data")), fields_of)


def test_truncated_message_is_told():
    raw = serialize_message(joints("fork", "rear", position=[0.1, 0.2]))
    asked = reader(JointState(), "position[rear]")
    asked.read(raw)
    for length in range(raw.index(b"rear")):
        with pytest.raises(SignalsError, match="malformed message"):
            asked.read(raw[:length])
