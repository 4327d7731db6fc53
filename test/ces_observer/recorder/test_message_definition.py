"""Definitions of message types from .msg texts, read back by rosbags' parser and checked against its own."""

from __future__ import annotations

import pytest
from raw_messages import JAZZY, msg_text
from rosbags.typesys import get_types_from_msg

from ces_observer.errors import SignalsError
from ces_observer.recorder.message_definition import SEPARATOR, message_definition


@pytest.mark.parametrize(
    "kind",
    [
        "std_msgs/msg/Float64",
        "sensor_msgs/msg/JointState",
        "geometry_msgs/msg/WrenchStamped",
        "sensor_msgs/msg/PointCloud2",  # an array of another type of its package
        "trajectory_msgs/msg/JointTrajectory",
        "diagnostic_msgs/msg/DiagnosticArray",
        "visualization_msgs/msg/MarkerArray",
    ],
)
def test_the_definition_has_all_types_and_they_are_the_same(kind: str) -> None:
    types = get_types_from_msg(message_definition(kind, msg_text), kind)
    assert kind in types
    expected = get_types_from_msg(JAZZY.generate_msgdef(kind, ros_version=2)[0], kind)
    assert types == expected


TEXTS = {
    "damper_msgs/msg/Valve": (
        "# Header in a comment\nuint8 OPEN=1\nstring NAME = 'a/b c'\nstd_msgs/Header header # the stamp\n"
        "string<=10 label 'none'\nCoil[] coils\nCoil[2] both\nCoil[<=3] few\nother_msgs/msg/Thing thing\n"
        "float64[3] gains [1.0, 2.0, 3.0]\n\n"
    ),
    "damper_msgs/msg/Coil": "float32 amperes 0.5\n",
    "other_msgs/msg/Thing": "uint64 a\n",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec\n",
}


def test_bounds_defaults_constants_and_comments() -> None:
    text = message_definition("damper_msgs/Valve", TEXTS.__getitem__)
    first, *others = text.split(f"{SEPARATOR}\nMSG: ")
    assert first.rstrip("\n") == TEXTS["damper_msgs/msg/Valve"].rstrip("\n")
    assert [other.partition("\n")[0] for other in others] == [
        "std_msgs/Header",
        "damper_msgs/Coil",
        "other_msgs/Thing",
        "builtin_interfaces/Time",
    ]


@pytest.mark.parametrize("name", ["Float64", "std_msgs/srv/Float64", "a/b/c/d", "std_msgs//Float64", ""])
def test_what_is_no_message_type(name: str) -> None:
    with pytest.raises(SignalsError, match="expected package/msg/Name"):
        message_definition(name, msg_text)
