"""Raw reading against FieldPath.read on the same message; rosbags serialises."""

from __future__ import annotations

import tracemalloc

import pytest
from cdr_messages import fields_of, message, serialised
from cdr_samples import JOINTS, READABLE, STAMP, joints, reader, signal, trajectory
from hypothesis import given, settings
from hypothesis import strategies as st

from ces_observer.cdr.layout import find_layout
from ces_observer.cdr.signal import RawSignal
from ces_observer.errors import SignalsError
from ces_observer.signals import FieldPath


@pytest.mark.parametrize(("built", "path"), READABLE, ids=[f"{m.__msgtype__}-{p}" for m, p in READABLE])
def test_raw_reading_is_that_of_the_message(built, path):
    described = signal(built.__msgtype__, path, scale=-0.5, offset=3)
    asked = RawSignal(described, fields_of)
    assert asked.stamped is hasattr(built, "header")
    assert [asked.read(serialised(built)) for _ in range(2)] == [read_message(built, described.make_reader())] * 2


def read_message(built, value_of):
    """Return what a raw reading of a message should give."""
    value = value_of(built)
    if not hasattr(built, "header"):
        return None, value, b""
    stamp = built.header.stamp
    return stamp.sec * 10**9 + stamp.nanosec, value, built.header.frame_id.encode()


NAMES = st.lists(st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9), max_size=4)
NUMBERS = st.lists(st.floats(width=64), max_size=5)
PATHS = ["position[rear]", "effort[rear]", "velocity[1]"]


@st.composite
def any_joints(draw):
    stamp_ns = draw(st.integers(-(2**31), 2**31 - 1)) * 10**9 + draw(st.integers(0, 10**9 - 1))
    frame_id = draw(st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9))
    names = draw(st.permutations([*draw(NAMES), "rear"]))
    return joints(names, draw(NUMBERS), stamp_ns, frame_id, velocity=draw(NUMBERS), effort=draw(NUMBERS))


def outcome(read, given_message):
    """Return what `read` gives, NaN made comparable, or the error's text."""
    try:
        return repr(read(given_message))
    except SignalsError as error:
        return str(error)


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(
    st.lists(any_joints(), min_size=1, max_size=8), st.sampled_from(["position[rear]", "effort[rear]", "velocity[1]"])
)
def test_one_reader_follows_any_joint_states(stream, path):
    described = signal(JOINTS, path)
    asked, value_of = RawSignal(described, fields_of), described.make_reader()
    for built in stream * 2:
        assert outcome(asked.read, serialised(built)) == outcome(lambda one: read_message(one, value_of), built)


@pytest.mark.parametrize(
    "read", [lambda path: reader(JOINTS, path).read, lambda path: signal(JOINTS, path).make_reader()]
)
def test_an_index_that_becomes_another_joint_is_unreadable_until_it_is_the_first_again(read):
    asked = read("position[1]")
    given = serialised if isinstance(getattr(asked, "__self__", None), RawSignal) else lambda built: built
    first, other = joints(["fork", "rear"], [0.1, 0.2]), joints(["rear", "fork"], [0.2, 0.1])
    for _ in range(2):
        asked(given(first))
        with pytest.raises(SignalsError, match=r"is position\[rear\] in the first message and position\[fork\] in an"):
            asked(given(other))


@pytest.mark.parametrize(
    ("built", "path"),
    [
        (joints(["fork"], [0.1]), "position[rear_damper]"),
        (joints([], [0.1]), "position[rear_damper]"),
        (joints(["fork", "rear"], [0.1]), "position[rear]"),
        (joints(["fork", "rear"], []), "effort[0]"),
        (message("sensor_msgs/Imu"), "orientation_covariance[9]"),
        (trajectory(), "points[a].effort[1]"),
        (trajectory(), "points[d].effort[1]"),
    ],
)
def test_a_missing_field_raises_the_same_error(built, path):
    with pytest.raises(SignalsError) as told:
        FieldPath.parse(path).read(built)
    with pytest.raises(SignalsError) as told_raw:
        reader(built.__msgtype__, path).read(serialised(built))
    assert str(told_raw.value) == str(told.value)


def test_missing_joint_comes_back():
    asked = reader(JOINTS, "position[rear]")
    there, gone = serialised(joints(["rear"], [0.1])), serialised(joints(["rare"], [0.1]))
    for _ in range(2):
        assert asked.read(there)[1] == 0.1
        with pytest.raises(SignalsError, match=r"no joint 'rear'; the message has \['rare'\]"):
            asked.read(gone)


def test_padding_behind_the_message_means_nothing():
    on_the_wire = serialised(message("std_msgs/Bool", data=True)) + bytes(3)  # as Cyclone DDS sends it
    assert reader("std_msgs/msg/Bool", "data").read(on_the_wire) == (None, 1.0, b"")


def walks(monkeypatch):
    """Return a list that grows by one at each walk."""
    made = []

    def counted(raw, record, path):
        made.append(len(raw))
        return find_layout(raw, record, path)

    monkeypatch.setattr("ces_observer.cdr.signal.find_layout", counted)
    return made


def test_publishers_of_different_layouts_share_a_topic_without_new_walks(monkeypatch):
    made = walks(monkeypatch)
    asked = reader(JOINTS, "position[rear]")
    for i in range(20):
        assert asked.read(serialised(joints(["rear", "fork"], [float(i), -1.0], i)))[:2] == (i, float(i))
        assert asked.read(serialised(joints(["fork", "rear"], [-1.0, float(i)], i)))[:2] == (i, float(i))
        assert asked.read(serialised(joints(["rear"], [float(i)], i, "base")))[1:] == (float(i), b"base")
    assert len(made) == 3


@pytest.mark.parametrize("path", ["position[rear]", "position[fork]", "effort[fork]"])
def test_changing_numbers_and_stamps_need_no_new_walk(monkeypatch, path):
    made = walks(monkeypatch)
    asked = reader(JOINTS, path)
    for i in range(20):
        built = joints(["rear", "fork"], [i, 2.0 * i], i * 10**9, velocity=[i], effort=[-i, 3.0 * i])
        assert asked.read(serialised(built))[:2] == (i * 10**9, FieldPath.parse(path).read(built))
    assert len(made) == 1


def test_rubbish_in_the_padding_needs_no_new_walk(monkeypatch):
    made = walks(monkeypatch)
    asked = reader(JOINTS, "position[rear]")
    raw = bytearray(serialised(joints(["rear", "fork"], [0.5, 0.6], frame_id="")))
    for rubbish in range(20):
        raw[17:20] = bytes([rubbish] * 3)  # behind the empty frame id's NUL
        assert asked.read(bytes(raw)) == (STAMP, 0.5, b"")
    assert len(made) == 1


def test_layouts_without_end_do_not_pile_up():
    asked = reader(JOINTS, "position[0]")
    raws = [serialised(joints([], [1.0], frame_id="x" * i)) for i in range(2000)]
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for raw in raws:
        assert asked.read(raw)[1] == 1.0
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 1_000_000  # all layouts together take ten times as much
