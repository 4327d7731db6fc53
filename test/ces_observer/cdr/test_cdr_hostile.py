"""Messages that are broken, made to do harm, or of a kind that is left to ordinary deserialisation."""

from __future__ import annotations

import struct

import pytest
from cdr_messages import STORE, message, serialised
from cdr_samples import JOINTS, READABLE, joints, reader, signal
from hypothesis import given, settings
from hypothesis import strategies as st

from ces_observer.cdr.layout import CdrUnsupportedError, find_layout, parse_message_type
from ces_observer.cdr.signal import RawSignal
from ces_observer.errors import SignalsError
from ces_observer.signals import FieldPath


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(st.sampled_from(READABLE), st.data())
def test_truncated_and_corrupted_messages_raise(readable, data):
    built, path = readable
    raw = serialised(built)
    asked = reader(built.__msgtype__, path)
    if data.draw(st.booleans()):
        asked.read(raw)  # a template is there
    broken = bytearray(raw[: data.draw(st.integers(0, len(raw)))])
    for _ in range(data.draw(st.integers(0, 3))):
        if broken:
            broken[data.draw(st.integers(0, min(len(broken), 120) - 1))] = data.draw(st.integers(0, 255))
    try:
        stamp_ns, value, frame_id = asked.read(bytes(broken))
    except SignalsError as error:
        assert str(error).startswith(f"field '{path}'")
    except CdrUnsupportedError:
        assert broken[:2] != raw[:2] or len(broken) > 10_000  # another representation, or a walk too long
    else:
        assert isinstance(value, float)
        assert isinstance(frame_id, bytes)
        assert stamp_ns is None or isinstance(stamp_ns, int)


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=200), st.sampled_from(READABLE))
def test_random_bytes_raise(rubbish, readable):
    built, path = readable
    try:
        reader(built.__msgtype__, path).read(b"\0\1\0\0" + rubbish)
    except SignalsError as error:
        assert str(error).startswith(f"field '{path}'")


def test_every_truncation_before_the_number_raises_and_none_behind_it():
    raw = serialised(joints(["fork", "rear"], [0.1, 0.2], effort=[1.0]))
    needed = raw.index(struct.pack("<d", 0.2)) + 8
    for length in range(len(raw)):
        asked = reader(JOINTS, "position[rear]")
        if length < needed:
            with pytest.raises(SignalsError, match=f"malformed message of {length} bytes"):
                asked.read(raw[:length])
        else:
            assert asked.read(raw[:length])[1] == 0.2


@pytest.mark.parametrize("options", [b"\0\0", b"\0\3", b"\xff\xff"])
def test_options_of_the_encapsulation_mean_nothing(options):
    raw = serialised(joints(["rear"], [0.5]))
    assert reader(JOINTS, "position[rear]").read(raw[:2] + options + raw[4:])[1] == 0.5


@pytest.mark.parametrize("representation", [0, 2, 3, 6, 7, 8, 9, 10, 11])
def test_other_representations_are_left_to_the_middleware(representation):
    raw = serialised(joints(["rear"], [0.5]))
    asked = reader(JOINTS, "position[rear]")
    asked.read(raw)
    with pytest.raises(CdrUnsupportedError, match=f"representation 0x{representation:04x}"):
        asked.read(bytes([0, representation]) + raw[2:])


def test_big_endian_message_is_left_to_the_middleware():
    raw = bytes(STORE.serialize_cdr(message("std_msgs/Float64", data=1.0), "std_msgs/msg/Float64", little_endian=False))
    with pytest.raises(CdrUnsupportedError):
        reader("std_msgs/msg/Float64", "data").read(raw)


def own_types(**types):
    return lambda name: types[name.rpartition("/")[2]]


@pytest.mark.parametrize(
    ("fields", "path", "text"),
    [
        ({"a": "wstring", "b": "double"}, "b", "a wstring comes before it"),
        ({"a": "sequence<wstring<5>, 3>", "b": "double"}, "b", "a wstring<5> comes before it"),
        ({"a": "other_msgs/Unknown[2]", "b": "double"}, "b", "a other_msgs/Unknown comes before it"),
    ],
)
def test_what_cannot_be_walked_over_is_left_to_the_middleware(fields, path, text):
    asked = RawSignal(signal("my_msgs/msg/My", path), own_types(My=fields))
    with pytest.raises(CdrUnsupportedError, match=text):
        asked.read(b"\0\1\0\0\1\0\0\0" + bytes(40))


def test_what_cannot_be_walked_over_may_follow():
    asked = RawSignal(signal("my_msgs/msg/My", "b"), own_types(My={"b": "double", "a": "wstring", "c": "long double"}))
    assert asked.read(b"\0\1\0\0" + struct.pack("<d", 1.5) + b"what") == (None, 1.5, b"")


@pytest.mark.parametrize(
    ("kind", "path"),
    [
        ("no_msgs/msg/Such", "data"),
        ("std_msgs/msg/String", "data"),
        ("std_msgs/msg/Byte", "data"),
        ("std_msgs/msg/String", "data[0]"),
        ("damper_msgs/msg/Late", "data"),
        ("damper_msgs/msg/Named", "values[a]"),
        (JOINTS, "header.stamp.sec"),
    ],
)
def test_types_and_fields_of_no_concern_here(kind, path):
    with pytest.raises(CdrUnsupportedError):
        reader(kind, path)


@pytest.mark.parametrize(
    ("kind", "path", "text"),
    [
        (JOINTS, "positions[0]", "field 'positions[0]': no 'positions' in JointState"),
        (JOINTS, "position[0].x", "field 'position[0].x': no 'x' in double"),
        (JOINTS, "position", "field 'position' is a sequence<double>, not a number"),
        ("geometry_msgs/msg/Wrench", "force", "field 'force' is a geometry_msgs/Vector3, not a number"),
        (
            "std_msgs/msg/Float64MultiArray",
            "data[rear]",
            "field 'data[rear]': no joint 'rear'; the message has no names",
        ),
    ],
)
def test_a_field_that_the_type_lacks_raises_at_once(kind, path, text):
    with pytest.raises(SignalsError) as caught:
        reader(kind, path)
    assert str(caught.value) == text


def claim(count):
    return struct.pack("<I", count)


@pytest.mark.parametrize(
    ("kind", "path", "body", "text"),
    [
        (JOINTS, "position[a]", bytes(8) + claim(2**32 - 1), "4294967295 bytes are expected at byte 16"),
        (JOINTS, "position[0]", bytes(8) + claim(1) + bytes(4) + claim(2**31), "2147483648 elements of a sequence<str"),
        (JOINTS, "position[0]", bytes(8) + claim(1) + bytes(8) + claim(3) + bytes(20), "3 elements of a sequence<doub"),
        (JOINTS, "position[0]", bytes(8) + claim(2) + b"ab" + bytes(40), "does not end in its only NUL"),
        (JOINTS, "position[0]", bytes(8) + claim(3) + b"a\0\0" + bytes(40), "does not end in its only NUL"),
        ("damper_msgs/msg/Valve", "last", bytes(33) + b"\1" * 3 + claim(2**30) * 40, "malformed message"),
    ],
)
def test_hostile_lengths_raise(kind, path, body, text):
    with pytest.raises(SignalsError, match=text):
        reader(kind, path).read(b"\0\1\0\0" + body)


def test_a_bounded_sequence_beyond_its_bound_raises():
    asked = RawSignal(signal("my_msgs/msg/My", "b"), own_types(My={"a": "sequence<uint8, 3>", "b": "uint8"}))
    assert asked.read(b"\0\1\0\0" + claim(3) + b"abc\5")[1] == 5.0
    with pytest.raises(SignalsError, match="4 elements of a sequence<uint8, 3> at byte 8"):
        asked.read(b"\0\1\0\0" + claim(4) + b"abcd\5")


def test_endless_walk_is_left_to_the_middleware():
    raw = b"\0\1\0\0" + bytes(8) + claim(1) + bytes(4) + claim(100_000) + bytes(4 * 100_000) + claim(1) + bytes(16)
    with pytest.raises(CdrUnsupportedError, match="more than 10000 parts before it"):
        reader(JOINTS, "position[0]").read(raw)


def test_a_million_parts_alike_are_passed_at_one_go():
    kind = {"a": "sequence<my_msgs/Part>", "b": "double"}
    part = {"x": "uint32", "y": "uint8[3]"}
    raw = b"\0\1\0\0" + claim(1_000_000) + bytes(8 * 1_000_000 + 4) + struct.pack("<d", 2.5)
    layout = find_layout(raw, parse_message_type("my_msgs/msg/My", own_types(My=kind, Part=part)), FieldPath.parse("b"))
    assert layout.offset == len(raw) - 8
