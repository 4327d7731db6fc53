from __future__ import annotations

import pytest
from cdr_messages import fields_of, header, message, serialised
from hypothesis import given, settings
from hypothesis import strategies as st

from ces_observer.cdr.joint_state import RawJointState
from ces_observer.cdr.signal import RawSignal
from ces_observer.errors import SignalsError
from ces_observer.signals import FieldPath, Signal

TEXTS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20)
STAMPS = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)
FLOATS = st.floats(width=64)


def joint_state(name, stamp_ns, frame_id, position, speed, force):
    return message(
        "sensor_msgs/JointState",
        header=header(stamp_ns, frame_id),
        name=[name],
        position=[position],
        velocity=[speed],
        effort=[force],
    )


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(TEXTS, st.lists(st.tuples(STAMPS, TEXTS, FLOATS, FLOATS, FLOATS), min_size=1, max_size=5))
def test_bytes_are_those_of_rosbags(name, estimates):
    writer = RawJointState([name])
    for stamp_ns, frame_id, *numbers in estimates * 2:
        raw = writer.fill(stamp_ns, frame_id.encode(), *numbers)
        assert raw == serialised(joint_state(name, stamp_ns, frame_id, *numbers))


@settings(max_examples=100, deadline=None)
@given(TEXTS, st.lists(st.tuples(STAMPS, TEXTS, FLOATS, FLOATS), min_size=1, max_size=5))
def test_bytes_of_bands_are_those_of_rosbags(name, bands):
    writer = RawJointState([f"{name}_lower", f"{name}_upper"], ["effort"])
    for stamp_ns, frame_id, *bounds in bands * 2:
        head = {"header": header(stamp_ns, frame_id), "name": [f"{name}_lower", f"{name}_upper"]}
        expected = message("sensor_msgs/JointState", **head, position=[], velocity=[], effort=bounds)
        assert writer.fill(stamp_ns, frame_id.encode(), *bounds) == serialised(expected)


def test_earlier_estimates_stay_as_they_were():
    writer = RawJointState(["rear"])
    first = writer.fill(1, b"", 1.0, 2.0, 3.0)
    kept = bytes(bytearray(first))
    writer.fill(2, b"", 4.0, 5.0, 6.0)
    assert first == kept


@pytest.mark.parametrize(("field", "value"), [("position[rear]", 1.0), ("velocity[0]", 2.0), ("effort[rear]", 3.0)])
def test_estimate_is_read_by_the_raw_reader(field, value):
    asked = RawSignal(Signal("position", "t", "sensor_msgs/msg/JointState", FieldPath.parse(field)), fields_of)
    assert asked.read(RawJointState(["rear"]).fill(5, b"base", 1.0, 2.0, 3.0)) == (5, value, b"base")


@pytest.mark.parametrize("stamp_ns", [2**31 * 10**9, -(2**31) * 10**9 - 1])
def test_a_stamp_out_of_range_raises(stamp_ns):
    with pytest.raises(SignalsError, match=f"stamp {stamp_ns} ns is out of the range"):
        RawJointState(["rear"]).fill(stamp_ns, b"", 1.0, 2.0, 3.0)
    with pytest.raises(SignalsError, match=f"stamp {stamp_ns} ns is out of the range"):
        RawJointState(["rear_lower", "rear_upper"], ["effort"]).fill(stamp_ns, b"", 1.0, 2.0)
