import shutil
import sqlite3
import warnings

import numpy as np
import pytest
import tiny_bags as tiny
import yaml
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from ces_data.bags.fields import list_numbers
from ces_data.bags.reader import RecordingWarning, list_topics, read_recording
from ces_observer.errors import CesError, RecordingError, SignalsError
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
        (MCAP, CompressionMode.NONE),
        (MCAP, CompressionMode.STORAGE),
        (MCAP, CompressionMode.FILE),
        (MCAP, CompressionMode.MESSAGE),
        (SQLITE, CompressionMode.NONE),
        (SQLITE, CompressionMode.FILE),
        (SQLITE, CompressionMode.MESSAGE),
    ],
)
def test_storage_and_compression(tmp_path, storage, compression):
    path = tiny.write(tmp_path / "run 1_0.5A", tiny.drive(), storage, compression)
    recording = same_as_plain_loop(path)
    assert (recording.name, recording.source) == ("run 1_0.5A", str(path))
    assert len(recording.sha256) == 64
    assert {c.name: c.unit for c in recording.channels.values()} == {"position": "m", "current": "A", "force": "N"}


def test_big_endian_messages(tmp_path):
    same_as_plain_loop(tiny.write(tmp_path / "b", tiny.drive(), little_endian=False))


def test_bare_file_is_the_same_recording(tmp_path):
    path = tiny.write(tmp_path / "run", tiny.drive())
    bare, folder = read_recording(path / "run.mcap", DEFAULT), read_recording(path, DEFAULT)
    assert (bare.name, bare.sha256) == (folder.name, folder.sha256)
    np.testing.assert_array_equal(bare.channel("force").values, folder.channel("force").values)


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


def test_bag_of_several_files(tmp_path):
    recording = same_as_plain_loop(split_bag(tmp_path))
    assert len(recording.channel("position")) == 50
    assert list_topics(tmp_path / "first")[0].count == 50


def test_bag_with_a_file_missing(tmp_path):
    path = split_bag(tmp_path)
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


def without_definitions(path):
    with sqlite3.connect(next(path.glob("*.db3"))) as database:
        database.execute("DELETE FROM message_definitions")
    return path


def test_bag_without_definitions_is_read_as_jazzy(tmp_path):
    same_as_plain_loop(without_definitions(tiny.write(tmp_path / "bag", tiny.drive(), SQLITE)))


def test_custom_type_without_definition(tmp_path):
    store = tiny.with_valve()
    valve = store.types[tiny.VALVE](header=tiny.header(1), mode="", flags=np.zeros(0, np.uint8), coils=[])
    path = tiny.write(tmp_path / "bag", [*tiny.drive(), ("/valve", tiny.VALVE, [(1, valve)])], SQLITE, store=store)
    without_definitions(path)
    same_as_plain_loop(path)
    with pytest.raises(RecordingError, match=r"/valve is damper_msgs/msg/Valve, neither of ROS 2 Jazzy nor defined"):
        read_recording(path, signals(current={"topic": "valve", "type": tiny.VALVE, "field": "coils[0].amperes"}))


def test_scale_offset_and_two_signals_in_one_topic(tmp_path):
    messages = [(i, tiny.joints(i + 7, ["a", "rear"], [i, 2 * i], efforts=[0, 3 * i])) for i in range(20)]
    path = tiny.write(tmp_path / "bag", [("/js", tiny.JOINTS, messages)])
    same = {"topic": "js", "type": tiny.JOINTS}
    description = signals(
        position={**same, "field": "position[rear]", "scale": 0.001, "offset": 0.5},
        current={"constant": 0.0},
        force={**same, "field": "effort[1]", "scale": -1.0},
    )
    recording = same_as_plain_loop(path, description)
    assert recording.constants == {"current": 0.0}
    np.testing.assert_array_equal(recording.channel("force").values, -3.0 * np.arange(20))


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


def test_log_time_stands_in_for_headers_that_were_never_filled(tmp_path):
    empty = [(i + 5, tiny.joints(0, ["rear_damper"], [i])) for i in range(9)]
    recording, messages = read_with_warnings(
        tiny.write(tmp_path / "a", [("/joint_states", tiny.JOINTS, empty), *tiny.drive()[1:]])
    )
    assert recording.channel("position").stamps_ns.tolist() == list(range(5, 14))
    assert "position: sensor_msgs/msg/JointState on /joint_states has an empty header stamp" in messages[0]
    some = [(i + 5, tiny.joints(i, ["rear_damper"], [i])) for i in range(9)]
    recording, messages = read_with_warnings(
        tiny.write(tmp_path / "b", [("/joint_states", tiny.JOINTS, some), *tiny.drive()[1:]])
    )
    assert recording.channel("position").stamps_ns.tolist() == list(range(9))
    assert len(messages) == 1


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


def test_missing_topic_names_the_topics_there_are(tmp_path):
    path = tiny.write(tmp_path / "bag", tiny.drive()[::2])
    assert failure(path, kind=RecordingError) == (
        f"{path}: no topic 'valve_current' for current; the bag has /joint_states (sensor_msgs/msg/JointState),"
        f" /measured_force (geometry_msgs/msg/WrenchStamped); 'ces signals {path} --out my_signals.yaml' proposes a"
        " file for --signals"
    )


def test_other_type_than_described(tmp_path):
    path = tiny.write(tmp_path / "bag", tiny.drive())
    message = failure(path, signals(current={"type": "std_msgs/msg/Float32"}), SignalsError)
    assert message.startswith("signals.yaml: signal 'current': topic 'valve_current' is std_msgs/msg/Float64 in ")
    assert "not std_msgs/msg/Float32" in message


@pytest.mark.parametrize(
    ("field", "phrase"),
    [
        ("position[front]", "no joint 'front'; the message has ['rear_damper']"),
        ("position[1]", "index 1 is outside an array of 1"),
        ("stroke", "no 'stroke' in"),
        ("name", "is a list, not a number"),
    ],
)
def test_field_that_is_not_there(tmp_path, field, phrase):
    path = tiny.write(tmp_path / "bag", tiny.drive())
    message = failure(path, signals(position={"field": field}), SignalsError)
    assert phrase in message
    assert "/joint_states: signal 'position'" in message
    assert message.endswith("; sensor_msgs/msg/JointState has position[rear_damper]")


def test_fields_that_a_message_has_are_spelled_as_in_ros(tmp_path):
    path = tiny.write(tmp_path / "bag", tiny.drive())
    message = failure(path, signals(force={"field": "wrench.force"}), SignalsError)
    assert "signal 'force': field 'wrench.force' is a geometry_msgs/msg/Vector3, not a number; geometry_msgs" in message
    listed = "has wrench.force.x, wrench.force.y, wrench.force.z, wrench.torque.x, wrench.torque.y, wrench.torque.z"
    assert message.endswith(listed)
    names = list(list_numbers(tiny.joints(0, ["a", "b"], [1.0, 2.0], efforts=[3.0, 4.0]), tiny.JOINTS, tiny.JAZZY))
    assert names == ["position[a]", "position[b]", "effort[a]", "effort[b]"]


def test_empty_bag(tmp_path):
    for storage in (MCAP, SQLITE):
        path = tiny.write(tmp_path / storage.name, [(t, k, []) for t, k, _ in tiny.drive()], storage)
        assert "the bag holds no messages" in failure(path, kind=RecordingError)
    nothing = tiny.write(tmp_path / "nothing", [])
    assert "the bag holds no messages" in failure(nothing, kind=RecordingError)


def test_topic_without_messages_is_an_empty_channel(tmp_path):
    path = tiny.write(tmp_path / "bag", [*tiny.drive()[:1], ("/valve_current", tiny.FLOAT, [])])
    assert len(read_recording(path, DEFAULT).channel("current")) == 0


@pytest.mark.parametrize(("share", "bare"), [(0.02, True), (0.3, True), (0.7, True), (0.98, True), (0.3, False)])
def test_truncated_mcap(tmp_path, share, bare):
    path = tiny.write(tmp_path / "bag", tiny.drive(n=400))
    file = path / "bag.mcap"
    whole = file.read_bytes()
    file.write_bytes(whole[: int(share * len(whole))])
    message = failure(file if bare else path, kind=RecordingError)
    assert "the file ends early" in message
    assert "mcap recover bag.mcap" in message


@pytest.mark.parametrize("compression", [CompressionMode.FILE, CompressionMode.MESSAGE, CompressionMode.NONE])
@pytest.mark.parametrize("storage", [MCAP, SQLITE])
def test_any_cut_is_one_clear_error_unless_all_messages_are_there(tmp_path, storage, compression):
    path = tiny.write(tmp_path / "bag", tiny.drive(n=60), storage, compression)
    file = next(f for f in path.iterdir() if f.suffix != ".yaml")
    whole = file.read_bytes()
    for cut in range(0, len(whole), len(whole) // 12):
        file.write_bytes(whole[:cut])
        try:
            recording = read_recording(path, DEFAULT)
        except RecordingError as error:
            assert str(path) in str(error)
            assert "\n" not in str(error)
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


def test_topics_are_listed_by_name(tmp_path):
    topics = list_topics(tiny.write(tmp_path / "bag", tiny.drive(n=7)))
    assert [(t.name, t.count) for t in topics] == [("/joint_states", 7), ("/measured_force", 7), ("/valve_current", 7)]
