"""Numbers decoded many at a time must be the ones rosbags reads one at a time, whatever the messages look like."""

import numpy as np
import pytest
import tiny_bags as tiny
from hypothesis import given, settings
from hypothesis import strategies as st

from ces_data.bags.decode import LAYOUTS_PER_LENGTH, Block, MessageDecoder
from ces_observer.errors import SignalsError
from ces_observer.signals import FieldPath

STORE = tiny.with_valve()
RNG = np.random.default_rng(3)


def paths_of(*texts):
    return [FieldPath.parse(text) for text in texts]


def block_of(payloads):
    """Payloads side by side with a byte between, so that nothing is aligned by luck."""
    raw = b"\xaa" + b"\xbb".join(payloads)
    lengths = np.array([len(p) for p in payloads], dtype=np.int64)
    starts = 1 + np.cumsum(lengths + 1) - (lengths + 1)
    zeros = np.zeros(len(payloads), dtype=np.int64)
    return Block(np.frombuffer(raw, dtype=np.uint8), zeros, zeros, starts, lengths)


def read_one(raw, kind, paths, names=()):
    message = STORE.deserialize_cdr(raw, kind)
    numbers = []
    for path, first in zip(paths, names or [""] * len(paths), strict=True):
        try:
            number, name = path.read_named(message)  # a number of another joint than the first message's is none
            numbers.append("another joint" if name and first and name != first else number)
        except SignalsError as error:
            numbers.append(str(error))
    return numbers


def name_of(message, path):
    try:
        return path.read_named(message)[1]
    except SignalsError:
        return ""


def slow_twin(payloads, kind, paths):
    names = [name_of(STORE.deserialize_cdr(payloads[0], kind), path) for path in paths] if payloads else ()
    read = [read_one(raw, kind, paths, names) for raw in payloads]
    rows = [[np.nan if isinstance(x, str) else x for x in row] for row in read]
    present = [[not isinstance(x, str) for x in row] for row in read]
    return np.array(rows, dtype=np.float64).reshape(-1, len(paths)), np.array(present).reshape(-1, len(paths))


def compare(messages, kind, *texts, little_endian=True):
    """Decode both ways; return how many messages the bulk decoder had to read one at a time."""
    paths = paths_of(*texts)
    payloads = [bytes(STORE.serialize_cdr(m, kind, little_endian=little_endian)) for m in messages]
    singles = []

    class Counting(MessageDecoder):
        def read_one(self, raw):
            singles.append(raw)
            return super().read_one(raw)

    decoder = Counting(kind, paths, STORE)
    half = len(payloads) // 2
    parts = [decoder.decode(block_of(part)) for part in (payloads[:half], payloads[half:]) if part]
    values, present = slow_twin(payloads, kind, paths)
    np.testing.assert_array_equal(np.concatenate([v for _, v, _ in parts]), values)
    np.testing.assert_array_equal(np.concatenate([p for _, _, p in parts]), present)
    return len(singles), decoder


STAMP = ("header.stamp.sec", "header.stamp.nanosec")


@pytest.mark.parametrize("little_endian", [True, False])
def test_numbers_without_header(little_endian):
    messages = [tiny.number(x) for x in [*RNG.standard_normal(40), np.nan, np.inf, -np.inf, -0.0]]
    singles, _ = compare(messages, tiny.FLOAT, "data", little_endian=little_endian)
    assert singles == (0 if little_endian else len(messages))


def test_joint_missing_in_some_messages_keeps_the_reason():
    names = [["rear", "fork"], ["fork", "seat"]]
    messages = [tiny.joints(i, names[i % 2], [i, -i]) for i in range(20)]
    _, decoder = compare(messages, tiny.JOINTS, "position[rear]", "velocity[rear]", "position[7]")
    assert "no joint 'rear'" in decoder.reasons[0]
    assert "outside an array" in decoder.reasons[2]


def test_equal_length_but_other_split_of_the_arrays():
    """Two layouts of the same total length must not be taken for one another."""
    messages = [tiny.joints(i, ["rear"], [i, 2 * i][: 1 + i % 2], efforts=[9.0, 8.0][i % 2 :]) for i in range(40)]
    lengths = {len(STORE.serialize_cdr(m, tiny.JOINTS)) for m in messages}
    assert len(lengths) == 1
    compare(messages, tiny.JOINTS, "position[0]", "effort[0]")


def test_nested_custom_type_with_strings_before_the_number():
    coil, valve = STORE.types["damper_msgs/msg/Coil"], STORE.types[tiny.VALVE]
    messages = [
        valve(
            header=tiny.header(i),
            mode="x" * (i % 3),
            flags=np.arange(1 + i % 2, dtype=np.uint8),
            coils=[coil(label="ab"[: i % 2], amperes=0.25 * i), coil(label="", amperes=-1.0)],
        )
        for i in range(90)
    ]
    singles, _ = compare(messages, tiny.VALVE, *STAMP, "coils[0].amperes", "coils[1].amperes", "flags[1]")
    assert singles == 0


def test_more_layouts_than_are_worth_learning_are_read_singly():
    names = [f"{chr(97 + i // 26)}{chr(97 + i % 26)}" for i in range(3 * LAYOUTS_PER_LENGTH)]
    messages = [tiny.joints(i, [name, "rear"], [i, -i]) for i, name in enumerate(names)]
    singles, _ = compare(messages, tiny.JOINTS, "position[rear]")
    assert singles == 2 * LAYOUTS_PER_LENGTH


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.permutations(["rear", "fork", "a", "bc"]).flatmap(lambda p: st.integers(0, 4).map(lambda n: p[:n])),
            st.text(max_size=6),
            st.lists(st.floats(), max_size=5),
            st.integers(-(2**31) * tiny.SECOND, (2**31 - 1) * tiny.SECOND),
        ),
        min_size=1,
        max_size=12,
    ),
    st.booleans(),
)
def test_any_joint_states(rows, little_endian):
    messages = [tiny.joints(stamp, names, values, frame) for names, frame, values, stamp in rows]
    compare(messages, tiny.JOINTS, *STAMP, "position[rear]", "position[1]", little_endian=little_endian)


def test_text_that_reads_as_a_number_is_left_to_rosbags():
    texts = [tiny.TYPES["std_msgs/msg/String"](data=f"{i}.5") for i in range(9)]
    assert compare(texts, "std_msgs/msg/String", "data")[0] == 9
