import re
import shutil
import sqlite3
import warnings

import numpy as np
import pytest
import tiny_bags as tiny
import yaml
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from ces_data.bags.reader import LateSamples, RecordingWarning, list_topics, read_recording, sort_late_samples
from ces_data.limits import OrderLimits
from ces_data.recording import Channel
from ces_observer.errors import CesError, RecordingError
from ces_observer.signals import Signals

DEFAULT = Signals.from_mapping({}, "defaults")
MCAP, SQLITE = StoragePlugin.MCAP, StoragePlugin.SQLITE3
pytestmark = pytest.mark.filterwarnings("ignore::ces_data.bags.reader.RecordingWarning")


def signals(**described):
    return Signals.from_mapping(described, "signals.yaml")


def plain_loop(path, description):
    """The slow twin: one message at a time, in the order of the log times."""
    stamps = {s.name: [] for s in description.list_topic_signals()}
    values = {s.name: [] for s in description.list_topic_signals()}
    with AnyReader([path], default_typestore=tiny.JAZZY) as reader:
        for connection, log_ns, raw in reader.messages():
            for signal in description.list_topic_signals():
                if signal.matches(connection.topic):
                    message = reader.deserialize(raw, connection.msgtype)
                    stamp = message.header.stamp if hasattr(message, "header") else None
                    stamps[signal.name].append(stamp.sec * tiny.SECOND + stamp.nanosec if stamp else log_ns)
                    values[signal.name].append(signal.make_reader()(message))
    return stamps, values


def same_as_plain_loop(path, description=DEFAULT):
    recording = read_recording(path, description)
    stamps, values = plain_loop(path, description)
    assert list(recording.channels) == [s.name for s in description.list_topic_signals()]
    for name, channel in recording.channels.items():
        np.testing.assert_array_equal(channel.stamps_ns, stamps[name])
        np.testing.assert_array_equal(channel.values, values[name])
    return recording


@pytest.mark.parametrize(
    ("storage", "compression"),
    [
        (MCAP, CompressionMode.STORAGE),
        (MCAP, CompressionMode.FILE),
        (MCAP, CompressionMode.MESSAGE),
        (SQLITE, CompressionMode.NONE),
        (SQLITE, CompressionMode.MESSAGE),
    ],
)
def test_storage_and_compression(tmp_path, storage, compression):
    path = tiny.write(tmp_path / "run 1_0.5A", tiny.drive(), storage, compression)
    recording = same_as_plain_loop(path)
    assert (recording.name, recording.source) == ("run 1_0.5A", str(path))
    assert len(recording.sha256) == 64
    assert {c.name: c.unit for c in recording.channels.values()} == {"position": "m", "current": "A", "force": "N"}


def split_bag(tmp_path):
    """A bag of two files, as `ros2 bag record --max-bag-duration` writes it."""
    first = tiny.write(tmp_path / "first", tiny.drive(n=30))
    second = tiny.write(tmp_path / "second", tiny.drive(n=20, start_ns=6 * tiny.SECOND))
    info = yaml.safe_load((first / "metadata.yaml").read_text())
    content = info["rosbag2_bagfile_information"]
    content["relative_file_paths"].append("second.mcap")
    content["message_count"] += 60
    for topic in content["topics_with_message_count"]:
        topic["message_count"] += 20
    (first / "metadata.yaml").write_text(yaml.safe_dump(info))
    shutil.copy(second / "second.mcap", first)
    return first


def test_bag_of_several_files_and_one_that_is_missing(tmp_path):
    path = split_bag(tmp_path)
    assert len(same_as_plain_loop(path).channel("position")) == list_topics(path)[0].count == 50
    (path / "second.mcap").unlink()
    with pytest.raises(RecordingError, match=r"cannot be opened as a bag: .*missing: .*second\.mcap"):
        read_recording(path, DEFAULT)


def test_custom_type_defined_in_the_bag(tmp_path):
    store = tiny.with_valve()
    coil, valve = store.types["damper_msgs/msg/Coil"], store.types[tiny.VALVE]
    coils = [[coil(label="main", amperes=0.1 * i), coil(label="", amperes=9.0)] for i in range(30)]
    messages = [
        (i, valve(header=tiny.header(i + 1), mode="", flags=np.zeros(2, np.uint8), coils=c))
        for i, c in enumerate(coils)
    ]
    path = tiny.write(tmp_path / "bag", [*tiny.drive()[:1], ("/valve", tiny.VALVE, messages)], store=store)
    described = {"topic": "/valve", "type": tiny.VALVE, "field": "coils[0].amperes", "scale": 2.0, "offset": -1.0}
    description = signals(current=described)
    channel = read_recording(path, description).channel("current")
    np.testing.assert_allclose(channel.values, 0.2 * np.arange(30) - 1.0, rtol=1e-6)
    np.testing.assert_array_equal(channel.stamps_ns, np.arange(1, 31))


def test_custom_type_without_definition(tmp_path):
    store = tiny.with_valve()
    valve = store.types[tiny.VALVE](header=tiny.header(1), mode="", flags=np.zeros(0, np.uint8), coils=[])
    path = tiny.write(tmp_path / "bag", [*tiny.drive(), ("/valve", tiny.VALVE, [(1, valve)])], SQLITE, store=store)
    with sqlite3.connect(next(path.glob("*.db3"))) as database:
        database.execute("DELETE FROM message_definitions")
    same_as_plain_loop(path)
    with pytest.raises(RecordingError, match=r"/valve is damper_msgs/msg/Valve, neither of ROS 2 Jazzy nor defined"):
        read_recording(path, signals(current={"topic": "valve", "type": tiny.VALVE, "field": "coils[0].amperes"}))


def test_order_is_that_of_recording_even_if_time_runs_backwards(tmp_path):
    times = [10, 20, 30, 15, 25]
    messages = [(t * tiny.SECOND, tiny.number(i)) for i, t in enumerate(times)]
    for storage in (MCAP, SQLITE):
        path = tiny.write(
            tmp_path / storage.name, [*tiny.drive()[:1], ("/valve_current", tiny.FLOAT, messages)], storage
        )
        channel = read_recording(path, DEFAULT).channel("current")
        assert (channel.stamps_ns // tiny.SECOND).tolist() == times
        assert channel.values.tolist() == [0, 1, 2, 3, 4]


def test_samples_without_the_joint_are_left_out_with_a_warning(tmp_path):
    names = [["rear_damper"], ["steering"]]
    messages = [(i, tiny.joints(i + 1, names[i % 2], [i])) for i in range(10)]
    path = tiny.write(tmp_path / "bag", [("/joint_states", tiny.JOINTS, messages), *tiny.drive()[1:]])
    with pytest.warns(RecordingWarning, match=r"position: missing in 5 of 10 messages on /joint_states: .*no joint"):
        channel = read_recording(path, DEFAULT).channel("position")
    assert channel.values.tolist() == [0, 2, 4, 6, 8]
    assert channel.stamps_ns.tolist() == [1, 3, 5, 7, 9]


def read_with_warnings(path):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RecordingWarning)
        recording = read_recording(path, DEFAULT)
    return recording, [str(w.message) for w in caught]


def test_log_time_stands_in_for_a_missing_header_with_one_warning(tmp_path):
    recording, messages = read_with_warnings(tiny.write(tmp_path / "bag", tiny.drive(late_ns=300)))
    assert recording.channel("current").stamps_ns[0] == 5 * tiny.SECOND + 300
    assert recording.channel("force").stamps_ns[0] == 5 * tiny.SECOND
    assert messages == [
        "current: std_msgs/msg/Float64 on /valve_current has no header; stamped with the bag's log time"
    ]


@pytest.mark.parametrize(("stamps", "first", "warnings"), [([0] * 9, 5, 2), (range(9), 0, 1)])
def test_log_time_stands_in_for_headers_that_were_never_filled(tmp_path, stamps, first, warnings):
    rows = [(i + 5, tiny.joints(stamp, ["rear_damper"], [i])) for i, stamp in enumerate(stamps)]
    path = tiny.write(tmp_path / "bag", [("/joint_states", tiny.JOINTS, rows), *tiny.drive()[1:]])
    recording, messages = read_with_warnings(path)
    assert recording.channel("position").stamps_ns.tolist() == list(range(first, first + 9))
    assert len(messages) == warnings
    empty = "position: sensor_msgs/msg/JointState on /joint_states has an empty header stamp"
    assert (empty in messages[0]) == (warnings == 2)


def test_optional_signals_may_be_absent(tmp_path):
    path = tiny.write(tmp_path / "bag", tiny.drive()[:2])
    assert list(read_recording(path, DEFAULT).channels) == ["position", "current"]
    with pytest.raises(RecordingError, match=r"no topic 'measured_force' for force; the bag has /joint_states \("):
        read_recording(path, DEFAULT, need=("position", "current", "force"))


def failure(path, description=DEFAULT, kind=CesError):
    with pytest.raises(kind) as caught:
        read_recording(path, description)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("described", "phrases"),
    [
        (
            {"current": {"topic": "/amps"}},
            (
                "no topic '/amps' for current; the bag has /joint_states (sensor_msgs/msg/JointState), /m",
                "'ces signals ",
            ),
        ),
        (
            {"current": {"type": "std_msgs/msg/Float32"}},
            ("signal 'current': topic 'valve_current' is std_msgs/msg/Float64 in ", "not std_msgs/msg/Float32"),
        ),
        ({"position": {"field": "position[front]"}}, ("no joint 'front'; the message has ['rear_damper']",)),
        ({"position": {"field": "stroke"}}, ("/joint_states: signal 'position'", "no 'stroke' in")),
        ({"position": {"field": "name"}}, ("is a list, not a number", "JointState has position[rear_damper]")),
        (
            {"force": {"field": "wrench.force"}},
            (
                "is a geometry_msgs/msg/Vector3, not a number",
                "has wrench.force.x, wrench.force.y, wrench.force.z, wrench.t",
            ),
        ),
    ],
)
def test_signals_that_are_not_in_the_bag(tmp_path, described, phrases):
    message = failure(tiny.write(tmp_path / "bag", tiny.drive()), signals(**described))
    assert [phrase for phrase in phrases if phrase not in message] == []


def test_empty_bag(tmp_path):
    for storage in (MCAP, SQLITE):
        path = tiny.write(tmp_path / storage.name, [(t, k, []) for t, k, _ in tiny.drive()], storage)
        assert "the bag holds no messages" in failure(path, kind=RecordingError)
    nothing = tiny.write(tmp_path / "nothing", [])
    assert "the bag holds no messages" in failure(nothing, kind=RecordingError)


@pytest.mark.parametrize(
    ("storage", "compression"),
    [(MCAP, CompressionMode.NONE), (SQLITE, CompressionMode.NONE), (MCAP, CompressionMode.FILE)],
)
def test_any_cut_is_one_clear_error_unless_all_messages_are_there(tmp_path, storage, compression):
    path = tiny.write(tmp_path / "bag", tiny.drive(n=60), storage, compression)
    file = next(f for f in path.iterdir() if f.suffix != ".yaml")
    whole = file.read_bytes()
    for cut in (*range(0, len(whole), len(whole) // 8), len(whole) - 100):
        file.write_bytes(whole[:cut])
        try:
            recording = read_recording(path, DEFAULT)
        except RecordingError as error:
            assert str(path) in str(error)
            assert "\n" not in str(error)
            cut_in_chunk = (storage, compression, cut > 100) == (MCAP, CompressionMode.NONE, True)
            assert not cut_in_chunk or re.search(r"the file ends early.*mcap recover bag\.mcap", str(error))
        else:
            assert [len(c) for c in recording.channels.values()] == [60, 60, 60]


def test_things_that_are_no_bag(tmp_path):
    assert "no such file or folder" in failure(tmp_path / "nothing", kind=RecordingError)
    assert "no metadata.yaml" in failure(tmp_path, kind=RecordingError)
    (tmp_path / "x.mcap").write_text("position,current\n")
    assert "is not an MCAP file" in failure(tmp_path / "x.mcap", kind=RecordingError)
    (tmp_path / "x.csv").write_text("position,current\n")
    line = failure(tmp_path / "x.csv", kind=RecordingError)
    assert f"is a CSV table, not a rosbag2 bag; convert it: ces import {tmp_path / 'x.csv'} --out BAG" in line
    bag = tiny.write(tmp_path / "bag", tiny.drive())
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: 3\n")
    assert "cannot be opened as a bag" in failure(bag, kind=RecordingError)


def test_message_that_does_not_fit_its_type(tmp_path):
    path = tiny.write(tmp_path / "bag", tiny.drive(), SQLITE)
    with sqlite3.connect(next(path.glob("*.db3"))) as database:
        database.execute("UPDATE messages SET data = x'000100000000' WHERE id = 20")
    message = failure(path, kind=RecordingError)
    assert "/joint_states: a message cannot be decoded as sensor_msgs/msg/JointState" in message


MS = 1_000_000
START = 7_000_000_000


def channel(stamps):
    return Channel("force", "N", stamps, np.arange(len(stamps), dtype=np.float64))


def regular(n=5000, period_ns=MS, jitter_ns=0):
    jitter = np.random.default_rng(1).integers(0, jitter_ns + 1, n)
    return START + np.arange(n) * period_ns + jitter


def store_late(stamps, rows, by):
    """Return the order in which samples are stored if those in `rows` come after the next `by`."""
    keys = np.arange(len(stamps), dtype=np.float64)
    keys[list(rows)] += by + 0.5
    return np.argsort(keys, kind="stable")


def test_channel_in_order_is_untouched():
    whole = channel(np.repeat(regular(), 2))
    assert sort_late_samples(whole) == (whole, None)
    assert sort_late_samples(whole)[0] is whole


@pytest.mark.parametrize(("rows", "by"), [([70], 1), (range(100, 5000, 37), 3), (range(100, 107), 20), ([0, 1], 90)])
def test_late_samples_are_sorted_in_with_their_values(rows, by):
    stamps = regular(jitter_ns=900_000)
    order = store_late(stamps, rows, by)
    stored = Channel("force", "N", stamps[order], order.astype(np.float64))
    found, late = sort_late_samples(stored)
    np.testing.assert_array_equal(found.stamps_ns, stamps)
    np.testing.assert_array_equal(found.values, np.arange(len(stamps)))
    assert late == LateSamples(
        len(rows), len(stamps), (np.maximum.accumulate(stored.stamps_ns) - stored.stamps_ns).max()
    )


@pytest.mark.parametrize("bursts", [2, 20])
def test_late_samples_within_bursts(bursts):
    """Log times of messages that arrive in bursts are much closer within one than between two."""
    stamps = START + np.arange(4000) // bursts * (bursts * MS) + np.arange(4000) % bursts * 20_000
    order = store_late(stamps, range(5, 3990, 31), 2)
    found, late = sort_late_samples(channel(stamps[order]))
    np.testing.assert_array_equal(found.stamps_ns, stamps)
    assert late.count > 50


def test_sample_later_than_the_window_is_left_as_it_is():
    stamps = regular()
    late = OrderLimits.MAX_LATE_NS // MS
    assert sort_late_samples(channel(stamps[store_late(stamps, [700], late)]))[1] is not None
    assert_unchanged(channel(stamps[store_late(stamps, [700], late + 1)]))


def test_clock_that_was_set_back_is_left_as_it_is():
    for back_ms, row, jitter_ns in (
        (6, 10, 0),
        (7.5, 4900, 900_000),
        (60, 2500, 0),
        (101, 10, 900_000),
        (4000, 4900, 0),
    ):
        stamps = regular(jitter_ns=jitter_ns)
        stamps[row:] -= int(back_ms * MS)
        assert_unchanged(channel(stamps))
    stamps = regular()
    stamps[3000:] -= 50 * MS
    assert_unchanged(channel(stamps[store_late(stamps, range(100, 5000, 37), 3)]))
    assert_unchanged(channel(np.tile(regular(500), 2)))  # a recording that is played again


def assert_unchanged(stored):
    found, late = sort_late_samples(stored)
    assert found is stored
    assert late is None
