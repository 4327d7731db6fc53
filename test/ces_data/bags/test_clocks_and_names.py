"""Bags whose header stamps and log times are of two clocks, whose joints change places, or lack a definition."""

import json
import warnings

import numpy as np
import pytest
import tiny_bags as tiny
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ces_data.bags.reader import RecordingWarning, read_recording
from ces_data.logs.log_file import refuse_bag
from ces_data.mapping.candidates import find_bag_candidates
from ces_data.mapping.proposals import propose_signals
from ces_observer.errors import RecordingError
from ces_observer.signals import Signals

DEFAULT = Signals.from_mapping({}, "defaults")
START, PERIOD, COUNT = 1_700_000_000 * tiny.SECOND, 2_000_000, 600
LOGGED = START + PERIOD * np.arange(COUNT)
pytestmark = pytest.mark.filterwarnings("ignore::ces_data.bags.reader.LogTimeWarning")


def write(path, stamps, joint=lambda k: (["rear_damper"], [0.001 * k]), force_stamps=None):
    """Write position and force with these header stamps, and a current without, logged at LOGGED."""
    pairs = list(zip(LOGGED.tolist(), np.asarray(stamps).tolist(), range(COUNT), strict=True))
    forces = np.asarray(stamps if force_stamps is None else force_stamps).tolist()
    streams = [
        ("/joint_states", tiny.JOINTS, [(log, tiny.joints(stamp, *joint(k))) for log, stamp, k in pairs]),
        ("/valve_current", tiny.FLOAT, [(log, tiny.number(0.01 * k)) for log, _, k in pairs]),
        ("/measured_force", tiny.WRENCH, [(log, tiny.wrench(forces[k], 10.0 * k)) for log, _, k in pairs]),
    ]
    return tiny.write(path, streams)


SINCE_BOOT = START * 1e-9 - 300.0
OFFSETS = [(0.5, "are 0.500 s behind"), (-2.0, "are 2.000 s ahead of"), (SINCE_BOOT, "count from a computer's start")]


@pytest.mark.parametrize(("behind_s", "words"), OFFSETS)
def test_log_times_are_moved_to_the_clock_of_the_headers(tmp_path, behind_s, words):
    stamps = LOGGED - round(behind_s * 1e9)
    path = write(tmp_path / "bag", stamps)
    with pytest.warns(RecordingWarning, match=f"{words}.* /valve_current has no header, and its log times are moved"):
        recording = read_recording(path, DEFAULT)
    np.testing.assert_allclose(recording.channel("current").stamps_ns, stamps, atol=1000)
    np.testing.assert_array_equal(recording.channel("position").stamps_ns, stamps)


def test_a_proposal_compares_signals_on_one_clock(tmp_path):
    path = write(tmp_path / "bag", LOGGED - START + 300 * tiny.SECOND)
    choices = propose_signals([path]).selection.dampers[""].choices
    first, last = choices["current"].candidate.stamps_ns[[0, -1]] - choices["position"].candidate.stamps_ns[[0, -1]]
    assert abs(first) < 1000 > abs(last)


@pytest.mark.parametrize("late_ns", [0, 3_000_000])
def test_the_way_of_a_message_is_no_other_clock(tmp_path, late_ns):
    recording = read_recording(write(tmp_path / "bag", LOGGED - late_ns), DEFAULT)
    np.testing.assert_array_equal(recording.channel("current").stamps_ns, LOGGED)


@pytest.mark.parametrize(("rate", "text"), [(0.5, "runs at 0.5 times"), (1.05, "runs at 1.05 times")])
def test_a_clock_that_drifts_is_refused_with_the_figure(tmp_path, rate, text):
    path = write(tmp_path / "bag", START + (rate * (LOGGED - START)).astype(np.int64))
    with pytest.raises(
        RecordingError, match=rf"{text} the speed of the log's, they are .* /valve_current, which has no"
    ):
        read_recording(path, DEFAULT)


def test_headers_of_two_clocks_are_refused(tmp_path):
    path = write(tmp_path / "bag", LOGGED, force_stamps=LOGGED - START + tiny.SECOND)
    with pytest.raises(
        RecordingError, match=r"/joint_states and /measured_force are of two clocks.*counts from a comp"
    ):
        read_recording(path, DEFAULT)


@pytest.mark.parametrize("at", [100, 400])
def test_a_clock_that_was_set_is_no_other_rate(tmp_path, at):
    path = write(tmp_path / "bag", LOGGED + 3 * tiny.SECOND * (np.arange(COUNT) >= at))
    with pytest.raises(RecordingError, match=rf"was set, they move by 3.000 s against each other after {at} messages"):
        read_recording(path, DEFAULT)


@pytest.mark.filterwarnings("error::ces_data.bags.reader.RecordingWarning")
def test_topics_whose_clocks_differ_are_named_until_the_difference_is_given(tmp_path):
    path = write(tmp_path / "bag", LOGGED, force_stamps=LOGGED - 800_000_000)
    with pytest.raises(
        RecordingWarning, match=r"of /measured_force are 0.800 s further behind .* than those of /joint"
    ):
        read_recording(path, DEFAULT)
    recording = read_recording(path, Signals.from_mapping({"force": {"delay": -0.8}}, "signals.yaml"))
    for name in ("force", "current"):
        np.testing.assert_array_equal(recording.channel(name).stamps_ns, LOGGED)


def test_a_few_empty_header_stamps_are_left_out_with_a_warning(tmp_path):
    path = write(tmp_path / "bag", LOGGED, force_stamps=np.where(np.arange(COUNT) < 20, 0, LOGGED))
    with pytest.warns(RecordingWarning, match=r"force: 20 of 600 messages on /measured_force have an empty header"):
        assert len(read_recording(path, DEFAULT).channel("force")) == COUNT - 20


@pytest.mark.parametrize("apart", [0.0, 0.02])
def test_two_publishers_of_one_joint_in_turn_are_named(tmp_path, apart):
    def joint(k):
        return ["rear_damper"], [0.01 * np.sin(0.05 * k) + apart * (k % 2)]

    path = write(tmp_path / "bag", LOGGED, joint)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_recording(path, DEFAULT)
    assert any("two publishers of one topic" in str(w.message) for w in caught) == bool(apart)


BY_INDEX = Signals.from_mapping({"position": {"field": "position[0]"}}, "signals.yaml")


def test_an_index_that_is_another_joint_is_refused_and_the_advice_works(tmp_path):
    def joint(k):
        return (["steer"], [9.0]) if k % 10 == 5 else (["rear_damper"], [0.001 * k])

    path = write(tmp_path / "bag", LOGGED, joint)
    found = (
        r"position\[0\] on /joint_states is 'position\[rear_damper\]' first, and 'position\[steer\]' in 60 of 600 .*"
    )
    with pytest.raises(RecordingError, match=found + r"; take it by name: position\[rear_damper\]"):
        read_recording(path, BY_INDEX)
    with pytest.warns(RecordingWarning, match=r"position: missing in 60 of 600 messages"):
        assert read_recording(path, DEFAULT).channel("position").values.max() < 1.0


def test_a_joint_that_only_later_messages_name_is_proposed(tmp_path):
    path = write(tmp_path / "bag", LOGGED, lambda k: (["rear_damper"], [0.001 * k]) if k % 3 else (["wheel"], [1.0]))
    assert "/joint_states position[rear_damper]" in {c.label for c in find_bag_candidates([path])[0]}


@pytest.mark.filterwarnings("ignore::ces_data.bags.reader.RecordingWarning")
def test_a_few_messages_of_another_order_are_left_out_with_a_warning(tmp_path):
    def joint(k):
        names, values = ["rear_damper", "steer"], [0.001 * k, 9.0]
        return (names[::-1], values[::-1]) if k == 300 else (names, values)

    path = write(tmp_path / "bag", LOGGED, joint)
    with pytest.warns(RecordingWarning, match=r"first, and 'position\[steer\]' in 1 of 600 messages .* left out"):
        channel = read_recording(path, BY_INDEX).channel("position")
    assert len(channel) == COUNT - 1
    assert channel.values.max() < 1.0


def write_defined(path, kind, definition):
    """Write the usual topics, and one of a type whose definition in the bag is this text."""
    store = get_typestore(Stores.ROS2_JAZZY)
    whole = "Part part\nfloat64 x\n" + "=" * 80 + "\nMSG: lab/Part\nfloat64 y\n"
    store.register(get_types_from_msg(whole, "lab/msg/Diagnosis"))
    with Writer(path, version=9) as writer:
        for topic, name, messages in tiny.drive():
            text = definition if name == kind else None
            connection = writer.add_connection(
                topic, name, typestore=store, msgdef=text, rihs01="RIHS01_0" if text else None
            )
            for log_ns, message in messages:
                writer.write(connection, log_ns, store.serialize_cdr(message, name))
        text = "lab/Part part\nfloat64 x\n"
        connection = writer.add_connection("/diag", "lab/msg/Diagnosis", msgdef=text, rihs01="RIHS01_0")
        part = store.types["lab/msg/Part"](y=1.0)
        raw = store.serialize_cdr(store.types["lab/msg/Diagnosis"](part=part, x=2.0), "lab/msg/Diagnosis")
        writer.write(connection, 5 * tiny.SECOND, raw)
    return path


def test_definitions_that_lack_types_of_ros_2_are_completed(tmp_path):
    path = write_defined(tmp_path / "bag", tiny.WRENCH, "std_msgs/Header header\ngeometry_msgs/Wrench wrench\n")
    recording = read_recording(path, DEFAULT)
    assert recording.channel("force").values.tolist() == [10.0 * i for i in range(50)]


def test_an_incomplete_type_of_another_topic_is_named_and_not_in_the_way(tmp_path):
    path = write_defined(tmp_path / "bag", "", "")
    assert read_recording(path, DEFAULT).channel("position").values[-1] == 0.049
    skipped = propose_signals([path]).skipped
    assert "uses lab/msg/Part, which neither the bag nor ROS 2 Jazzy defines" in skipped["/diag"]
    signals = {"force": {"topic": "diag", "type": "lab/msg/Diagnosis", "field": "x"}}
    with pytest.raises(RecordingError, match=r"lab/msg/Diagnosis in the bag uses lab/msg/Part.*mcap filter"):
        read_recording(path, Signals.from_mapping(signals, "signals.yaml"), need=("force",))


def write_foreign(path, encoding, schema, topics):
    """Write an MCAP file of 50 messages on each of these topics: its type, its definition, and message k's bytes."""
    from mcap.writer import Writer as McapWriter

    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        for topic, (kind, text, raw) in topics.items():
            number = writer.register_schema(kind, schema, text.encode())
            channel = writer.register_channel(topic, encoding, number)
            for k in range(50):
                writer.add_message(channel, k * 10_000_000, raw(k), k * 10_000_000)
        writer.finish()
    return path


def test_publishers_that_were_there_when_a_topic_was_recorded_are_counted(tmp_path):
    none, one = QosTime(0, 0), 1
    kinds = QosHistory(one), 10, QosReliability(one), QosDurability(one)
    qos = Qos(*kinds, none, none, QosLiveliness(one), none, False)
    with Writer(tmp_path / "bag", version=9) as writer:
        for topic, kind, messages in tiny.drive():
            two = [qos] * (2 if topic == "/valve_current" else 1)
            connection = writer.add_connection(topic, kind, typestore=tiny.JAZZY, offered_qos_profiles=two)
            for log_ns, message in messages:
                writer.write(connection, log_ns, tiny.JAZZY.serialize_cdr(message, kind))
    with pytest.warns(RecordingWarning, match="current: /valve_current had 2 publishers when it was recorded, whose"):
        read_recording(tmp_path / "bag", DEFAULT)


def test_json_inside_mcap_is_read_as_messages_of_numbers_and_what_is_missing_is_none(tmp_path):
    def rig(k):
        state = {"damper": {"x [m]": 0.001 * k, "ok": True}, "name": ["rear", "front"], "load": [10.0 * k, None, 3]}
        return json.dumps({**state, "load": [10.0 * k, 1] if k != 7 else None, "2nd": None, "text": "on"}).encode()

    path = write_foreign(tmp_path / "log.mcap", "json", "jsonschema", {"/rig": ("lab.Rig", "{}", rig)})
    source = {"topic": "rig", "type": "json/msg/lab_Rig"}
    fields = {"position": {**source, "field": "damper.x__m"}, "force": {**source, "field": "load[rear]"}}
    with pytest.warns(RecordingWarning, match="force: missing in 1 of 50 messages on /rig"):
        recording = read_recording(path, Signals.from_mapping(fields, "signals.yaml"), need=("position", "force"))
    assert recording.channel("position").values.tolist() == [0.001 * k for k in range(50)]
    assert recording.channel("force").values.tolist() == [10.0 * k for k in range(50) if k != 7]
    with pytest.raises(RecordingError, match="a bag needs no import"):
        refuse_bag(path)


def test_ros_1_inside_mcap_is_read(tmp_path):
    store = get_typestore(Stores.ROS1_NOETIC)

    def joints(k):
        head = store.types["std_msgs/msg/Header"](k, store.types["builtin_interfaces/msg/Time"](k, 0), "")
        numbers = np.array([0.001 * k]), np.empty(0), np.empty(0)
        message = store.types["sensor_msgs/msg/JointState"](head, ["rear_damper"], *numbers)
        return bytes(store.serialize_ros1(message, "sensor_msgs/msg/JointState"))

    text, _ = store.generate_msgdef("sensor_msgs/msg/JointState", ros_version=1)
    topics = {"/joint_states": ("sensor_msgs/JointState", text, joints)}
    position = read_recording(write_foreign(tmp_path / "a.mcap", "ros1", "ros1msg", topics), DEFAULT, need=()).channel(
        "position"
    )
    assert (position.values.tolist(), position.stamps_ns[3]) == ([0.001 * k for k in range(50)], 3 * tiny.SECOND)


def test_another_encoding_inside_mcap_is_in_the_way_only_where_it_is_needed(tmp_path):
    kinds = {"/joint_states": ("sensor_msgs/msg/JointState", "", bytes)}
    path = write_foreign(tmp_path / "a.mcap", "protobuf", "protobuf", kinds)
    with pytest.raises(RecordingError, match="is encoded as 'protobuf'; expected cdr, ros1 or json; write its numbers"):
        read_recording(path, DEFAULT, need=("position",))


INTERFACES = (
    "std_msgs/Header header\nstring[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values\n"
    + "=" * 80
    + "\nMSG: control_msgs/InterfaceValue\nstring[] interface_names\nfloat64[] values\n"
)


def test_interfaces_of_a_joint_whose_order_changes_are_named_and_not_mixed(tmp_path):
    store, kind = get_typestore(Stores.ROS2_JAZZY), "control_msgs/msg/DynamicJointState"
    store.register(get_types_from_msg(INTERFACES, kind))

    def state(k):
        names = ["position", "effort"] if k < 300 else ["effort", "position"]
        of = store.types["control_msgs/msg/InterfaceValue"](
            names, np.array([{"position": 0.1, "effort": 9.0}[n] for n in names])
        )
        return store.types[kind](tiny.header(int(LOGGED[k])), ["damper"], [of])

    rows = [(int(LOGGED[k]), state(k)) for k in range(COUNT)]
    path = tiny.write(tmp_path / "bag", [("/states", kind, rows), *tiny.drive()], store=store)
    field = "interface_values[0].values[0]"
    named = [f"interface_values[damper].values[{name}]" for name in ("position", "effort")]

    def read(text):
        signals = {"position": {"topic": "states", "type": kind, "field": text}}
        return read_recording(path, Signals.from_mapping(signals, "signals.yaml"), need=("position",))

    with pytest.raises(RecordingError) as error:
        read(field)
    assert f"is '{named[0]}' first, and '{named[1]}' in 300 of 600 messages" in str(error.value)
    assert str(error.value).endswith(f"take it by name: {named[0]}")
    assert [set(read(text).channel("position").values.tolist()) for text in named] == [{0.1}, {9.0}]
    assert {f"/states {text}" for text in named} <= {c.label for c in find_bag_candidates([path])[0]}
