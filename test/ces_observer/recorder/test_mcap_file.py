"""MCAP files and rosbag2 folders written here, read back by others to the last byte."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from raw_messages import CURRENT, FORCE, POSITION, SECOND, TOPICS, channels, drive
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from ces_observer.errors import RecordingError
from ces_observer.recorder.bag_folder import BagFolder
from ces_observer.recorder.mcap_file import CHUNK_BYTES, BagChannel, McapFile, require_mcap

Message = tuple[int, int, bytes]
START = 1_700_000_000 * SECOND


def write(path: Path, messages: list[Message], of: list[BagChannel] | None = None) -> Path:
    file = McapFile(path, channels() if of is None else of)
    for message in messages:
        file.write(*message)
    file.close()
    return path


def write_bag(path: Path, messages: list[Message]) -> Path:
    bag = BagFolder(path, channels(), {"why": 'a "test": ü\n{}'})
    for message in messages:
        bag.write(*message)
    bag.end()
    assert not path.exists()
    bag.place()
    return path


def read_with_mcap(path: Path) -> list[tuple[str, int, bytes]]:
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        return [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages(log_time_order=True)]


def test_the_mcap_package_reads_every_byte(tmp_path: Path) -> None:
    messages = drive(START, 2.0)
    assert sum(len(raw) for _, _, raw in messages) > 5 * CHUNK_BYTES
    path = write(tmp_path / "a.mcap", messages)
    assert read_with_mcap(path) == [(TOPICS[channel][0], time, raw) for channel, time, raw in messages]
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        only = [m.data for _, _, m in reader.iter_messages(["/valve_current"])]  # by the index
    assert summary is not None and summary.statistics is not None
    assert summary.statistics.message_count == len(messages)
    assert summary.statistics.channel_message_counts == {1: 2000, 2: 400, 3: 2000, 4: 2000}
    times = [time for _, time, _ in messages]
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (min(times), max(times))
    assert (summary.statistics.schema_count, summary.statistics.channel_count) == (3, 4)
    assert len(summary.chunk_indexes) == summary.statistics.chunk_count > 5
    assert [s.name for s in summary.schemas.values()] == list(dict.fromkeys(kind for _, kind in TOPICS))
    assert only == [raw for channel, _, raw in messages if channel == CURRENT]


def test_rosbags_reads_every_byte(tmp_path: Path) -> None:
    messages = drive(START, 2.0)
    path = write_bag(tmp_path / "run", messages)
    with Reader(path) as reader:
        read = [(connection.topic, time, bytes(raw)) for connection, time, raw in reader.messages()]
        assert {c.topic: (c.msgtype, c.msgcount) for c in reader.connections} == {
            topic: (kind, 400 if channel == CURRENT else 2000) for channel, (topic, kind) in enumerate(TOPICS)
        }
        assert [c.digest for c in reader.connections] == [c.type_hash for c in channels()]
    assert read == [(TOPICS[channel][0], time, raw) for channel, time, raw in messages]
    assert sorted(file.name for file in path.iterdir()) == ["metadata.yaml", "run.mcap"]
    assert [file.name for file in tmp_path.iterdir()] == ["run"]


def test_the_file_alone_tells_its_types(tmp_path: Path) -> None:
    """A reader without ROS decodes the messages by the definitions in the file."""
    path = write(tmp_path / "a.mcap", drive(START, 0.01))
    with AnyReader([path]) as reader:
        read = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages() if c.topic == "/measured_force"]
    assert read[0].header.frame_id == "chassis"
    assert read[3].header.stamp.sec * SECOND + read[3].header.stamp.nanosec == START + 3_000_000
    assert read[3].wrench.force.z != 0.0


def test_metadata_has_the_fields_of_jazzy(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "run", drive(START, 0.1))
    metadata = yaml.safe_load((path / "metadata.yaml").read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
    example = yaml.safe_load((Path(__file__).parents[3] / "bags/sine_4hz/metadata.yaml").read_text())
    expected = example["rosbag2_bagfile_information"]
    assert metadata.keys() == expected.keys()
    assert (metadata["version"], metadata["storage_identifier"]) == (9, "mcap")
    topics, others = metadata["topics_with_message_count"], expected["topics_with_message_count"]
    assert topics[0]["topic_metadata"].keys() == others[0]["topic_metadata"].keys()
    assert topics[POSITION]["topic_metadata"] == others[0]["topic_metadata"]
    assert topics[FORCE]["topic_metadata"] == others[2]["topic_metadata"]
    assert metadata["files"][0].keys() == expected["files"][0].keys()
    assert metadata["custom_data"] == {"why": 'a "test": ü\n{}'}
    assert metadata["starting_time"] == {"nanoseconds_since_epoch": START + 150_000}
    assert metadata["duration"] == {"nanoseconds": 99_250_000}


@settings(deadline=None, max_examples=50)
@given(
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 2**63 - 1), st.binary(max_size=2 * CHUNK_BYTES)), max_size=20)
)
def test_any_bytes_at_any_time_come_back(tmp_path_factory: pytest.TempPathFactory, messages: list[Message]) -> None:
    path = write(tmp_path_factory.mktemp("any") / "a.mcap", messages)
    expected = sorted(((TOPICS[channel][0], time, raw) for channel, time, raw in messages), key=lambda m: m[1])
    assert sorted(read_with_mcap(path)) == sorted(expected)
    with AnyReader([path]) as reader:
        read = [(connection.topic, time, bytes(raw)) for connection, time, raw in reader.messages()]
    assert sorted(read) == sorted(expected)


def test_no_channels_and_no_messages(tmp_path: Path) -> None:
    assert read_with_mcap(write(tmp_path / "none.mcap", [], of=[])) == []
    assert read_with_mcap(write(tmp_path / "empty.mcap", [])) == []


def test_an_existing_file_is_not_overwritten(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", drive(START, 0.01))
    before = path.read_bytes()
    with pytest.raises(FileExistsError):
        McapFile(path, channels())
    assert path.read_bytes() == before


def test_without_the_mcap_package_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    require_mcap()
    monkeypatch.setitem(sys.modules, "mcap", None)
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(RecordingError, match=r"package mcap is missing; install it with: pip install mcap"):
        require_mcap()


@pytest.mark.skipif(shutil.which("mcap") is None, reason="the mcap program is not installed")
def test_the_mcap_program_finds_no_fault(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", drive(START, 0.5))
    done = subprocess.run(
        ["mcap", "doctor", "--strict-message-order", path], capture_output=True, text=True, check=True
    )
    assert "error" not in done.stdout.lower()
