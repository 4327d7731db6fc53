"""ROS 1 bags written by rosbags: read by every program with a signals file, and imported with a mapping."""

from pathlib import Path

import numpy as np
import pytest
from log_examples import I_SLOW, START_NS, T_SLOW, F, T, X, assert_proposed, assert_recording
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ces_data.bags.reader import read_recording
from ces_data.logs.log_import import import_log
from ces_data.logs.log_mapping import parse_dyno_mapping
from ces_data.mapping.proposals import propose_signals
from ces_data.signals_file import load_signals
from ces_observer.errors import CesError

pytestmark = pytest.mark.filterwarnings("ignore::ces_data.bags.reader.RecordingWarning")
CUSTOM = "lab/msg/Valve"
MAPPING = (
    'position: {column: "/joint_states position[rear_damper]"}\n'
    'current: {column: "/valve current_mA"}\nforce: {column: "/load wrench.force.z"}\n'
)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("std_msgs/Header header\nstring mode\nfloat32 current_mA\n", CUSTOM))
    path = tmp_path_factory.mktemp("ros1") / "run.bag"
    writer = Writer(path)
    writer.set_compression(Writer.CompressionFormat.LZ4)
    with writer:
        for stamp, topic, message in sorted(messages(store.types), key=lambda row: row[0]):
            kind = message.__msgtype__
            found = [c for c in writer.connections if c.topic == topic]
            connection = found[0] if found else writer.add_connection(topic, kind, typestore=store)
            writer.write(connection, stamp, store.serialize_ros1(message, kind))
    return path


def messages(types):
    def header(stamp, frame):
        time = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
        return types["std_msgs/msg/Header"](seq=7, stamp=time, frame_id=frame)

    empty, vector = np.zeros(0), types["geometry_msgs/msg/Vector3"]
    for k, t in enumerate(np.rint(T * 1e9).astype(int).tolist()):
        stamp = START_NS + t
        names, place = ["wheel", "rear_damper"], np.array([0.1, X[k]])
        joint = types["sensor_msgs/msg/JointState"](
            header=header(stamp, ""), name=names, position=place, velocity=empty, effort=empty
        )
        yield stamp + 50, "/joint_states", joint
        wrench = types["geometry_msgs/msg/Wrench"](
            force=vector(x=0.0, y=0.0, z=F[k]), torque=vector(x=0.0, y=0.0, z=0.0)
        )
        yield stamp + 60, "/load", types["geometry_msgs/msg/WrenchStamped"](header=header(stamp, "rig"), wrench=wrench)
    for t, i in zip(np.rint(T_SLOW * 1e9).astype(int).tolist(), I_SLOW.tolist(), strict=True):
        stamp = START_NS + t
        yield stamp + 70, "/valve", types[CUSTOM](header=header(stamp, "abc"), mode="auto", current_mA=1000 * i)


def test_every_program_reads_it_with_a_signals_file(path, tmp_path):
    proposal = propose_signals([path])
    assert proposal.selection.checks == ()
    (tmp_path / "s.yaml").write_text(proposal.text)
    assert_recording(read_recording(path, load_signals(tmp_path / "s.yaml")), START_NS, rtol=1e-6)


def test_import_with_a_mapping(path):
    text = MAPPING.replace('mA"}', 'mA", unit: mA}')
    assert_recording(import_log(path, parse_dyno_mapping(text, "map.yaml")), START_NS, rtol=1e-6)


def test_a_proposal_needs_no_mapping(path):
    assert_proposed(path, start_ns=START_NS, rtol=1e-6)


def test_mistakes_are_one_line(path, tmp_path):
    for old, new, message in (
        ("/load wrench", "/last wrench", r"no topic '/last'; the bag has /joint_states \(sensor_msgs/msg/JointState\)"),
        ("force.z", "force.w", "no 'w' in"),
        ("/load wrench.force.z", "/load", "expected topic and field, such as '/measured_force wrench.force.z'"),
        ("position[rear_damper]", "position[front]", "no joint 'front'"),
    ):
        with pytest.raises(CesError, match=message.replace("[", r"\[")):
            import_log(path, parse_dyno_mapping(MAPPING.replace(old, new), "map.yaml"))
    damaged = Path(tmp_path / "damaged.bag")
    damaged.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(CesError, match="not a ROS 1 bag, or damaged"):
        import_log(damaged, parse_dyno_mapping(MAPPING, "map.yaml"))
