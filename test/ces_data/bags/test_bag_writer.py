from operator import itemgetter
from pathlib import Path

import numpy as np
import pytest
import tiny_bags as tiny
import yaml
from mcap.reader import NonSeekingReader, make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from ces_data.bags import writer
from ces_data.bags.reader import list_topics, read_recording
from ces_data.bags.writer import TopicData, recording_topics, write_bag
from ces_data.recording import Channel, Recording
from ces_observer import __version__
from ces_observer.errors import RecordingError, SignalsError
from ces_observer.signals import Signals

DEFAULT = Signals.from_mapping({}, "defaults")
pytestmark = pytest.mark.filterwarnings("ignore::ces_data.bags.reader.RecordingWarning")


def recording_of(n=200, **stamps):
    rng = np.random.default_rng(7)
    units = {"position": "m", "current": "A", "force": "N"}
    times = {name: np.sort(rng.integers(0, 10**10, n)) for name in units} | stamps
    return Recording("run", {k: Channel(k, u, times[k], rng.standard_normal(n)) for k, u in units.items()})


def same(a, b):
    assert list(a.channels) == list(b.channels)
    for name in a.channels:
        np.testing.assert_array_equal(a.channel(name).stamps_ns, b.channel(name).stamps_ns)
        np.testing.assert_array_equal(a.channel(name).values, b.channel(name).values)


def test_recording_comes_back_to_the_bit(tmp_path):
    recording = recording_of()
    write_bag(tmp_path / "deep" / "run", recording_topics(recording, DEFAULT))
    same(read_recording(tmp_path / "deep" / "run", DEFAULT), recording)
    assert [p.name for p in (tmp_path / "deep").iterdir()] == ["run"]
    assert sorted(p.name for p in (tmp_path / "deep" / "run").iterdir()) == ["metadata.yaml", "run.mcap"]


def test_scale_and_offset_are_undone(tmp_path):
    described = {
        "position": {"scale": 0.0254, "offset": 0.5, "field": "position[2]"},
        "current": {"type": "std_msgs/msg/Float32", "scale": -2.0},
        "force": {"type": "std_msgs/msg/Int16", "field": "data", "scale": 10.0},
    }
    signals = Signals.from_mapping(described, "signals.yaml")
    recording = recording_of()
    write_bag(tmp_path / "run", recording_topics(recording, signals))
    read = read_recording(tmp_path / "run", signals)
    for name, step in (("position", 1e-15), ("current", 4e-7), ("force", 5.0)):
        np.testing.assert_allclose(read.channel(name).values, recording.channel(name).values, rtol=0, atol=step)


def test_replay_topic_with_named_columns(tmp_path):
    stamps, values = np.arange(9), np.linspace(0, 1, 9)
    columns = {f"{field}[rear_damper]": k * values for k, field in enumerate(("position", "velocity", "effort"))}
    write_bag(
        tmp_path / "b", [TopicData("/observer/estimate", tiny.JOINTS, stamps, columns)], notes={"model": "m.json"}
    )
    with AnyReader([tmp_path / "b"]) as reader:
        last = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()][-1]
    assert (last.name, last.position[0], last.velocity[0], last.effort[0]) == (["rear_damper"], 0.0, 1.0, 2.0)
    assert (last.header.stamp.sec, last.header.stamp.nanosec) == (0, 8)
    metadata = yaml.safe_load((tmp_path / "b" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert metadata["custom_data"] == {"model": "m.json", "written_by": f"ces_observer {__version__}"}


def test_channels_that_share_a_topic_need_the_same_stamps(tmp_path):
    signals = Signals.from_mapping(
        {"force": {"topic": "joint_states", "type": tiny.JOINTS, "field": "effort[rear_damper]"}}, "signals.yaml"
    )
    stamps = np.arange(200)
    recording = recording_of(position=stamps, force=stamps)
    write_bag(tmp_path / "run", recording_topics(recording, signals))
    same(read_recording(tmp_path / "run", signals), recording)
    with pytest.raises(RecordingError, match="position and force share topic joint_states but not their stamps"):
        recording_topics(recording_of(), signals)


def test_stamps_that_run_backwards_and_bad_samples_survive(tmp_path):
    stamps = np.array([5, 3, 9, 9, 7]) * 1_000_000_000
    values = np.array([np.nan, 1, np.inf, -np.inf, 2])
    channels = {k: Channel(k, "", stamps, values) for k in ("position", "current")}
    write_bag(tmp_path / "run", recording_topics(Recording("run", channels), DEFAULT))
    same(read_recording(tmp_path / "run", DEFAULT), Recording("run", channels))


def test_existing_bag_is_overwritten_only_on_request(tmp_path):
    topics = recording_topics(recording_of(), DEFAULT)
    write_bag(tmp_path / "run", topics[:1])
    with pytest.raises(RecordingError, match=r"run: exists; choose another name, or replace it with overwrite=True"):
        write_bag(tmp_path / "run", topics)
    assert len(list_topics(tmp_path / "run")) == 1
    write_bag(tmp_path / "run", topics, overwrite=True)
    assert len(list_topics(tmp_path / "run")) == 3
    assert [p.name for p in tmp_path.iterdir()] == ["run"]
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "letter").write_text("dear")
    with pytest.raises(RecordingError, match="is not a bag, so it is not overwritten"):
        write_bag(tmp_path / "home", topics, overwrite=True)
    with pytest.raises(RecordingError, match=r"run: cannot be written: .*; choose another place"):
        write_bag(tmp_path / "home" / "letter" / "run", topics)
    assert (tmp_path / "home" / "letter").read_text() == "dear"


def test_of_two_bags_written_at_once_the_first_stays_and_the_second_is_told(tmp_path):
    topics = recording_topics(recording_of(), DEFAULT)
    with (
        pytest.raises(RecordingError, match="run: cannot be written: Directory not empty"),
        writer.open_bag_writer(tmp_path / "run") as second,
    ):
        write_bag(tmp_path / "run", topics[:1])
        second.write(topics)
    assert len(list_topics(tmp_path / "run")) == 1


@pytest.mark.parametrize("overwrite", [False, True])
def test_interrupted_write_leaves_nothing_half_written(tmp_path, monkeypatch, overwrite):
    topics = recording_topics(recording_of(), DEFAULT)
    if overwrite:
        write_bag(tmp_path / "run", topics[:1])

    def stop(encoder, topic, part):
        raise KeyboardInterrupt

    monkeypatch.setattr(writer._Encoder, "records", stop)
    with pytest.raises(KeyboardInterrupt):
        write_bag(tmp_path / "run", topics, overwrite=overwrite)
    assert [p.name for p in tmp_path.iterdir()] == (["run"] if overwrite else [])
    assert not overwrite or len(list_topics(tmp_path / "run")) == 1


def test_failed_rename_brings_the_old_bag_back(tmp_path, monkeypatch):
    topics = recording_topics(recording_of(), DEFAULT)
    write_bag(tmp_path / "run", topics[:1])
    rename = Path.rename

    def fail(self, target):
        if Path(target) == tmp_path / "run" and self.name == "run":
            raise OSError(28, "No space left on device")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fail)
    with pytest.raises(RecordingError, match=r"run: cannot be written: No space left on device"):
        write_bag(tmp_path / "run", topics, overwrite=True)
    assert len(list_topics(tmp_path / "run")) == 1


@pytest.mark.parametrize(
    ("kind", "field", "phrase"),
    [
        ("damper_msgs/msg/Valve", "data", "not a type of ROS 2 Jazzy"),
        ("std_msgs/msg/Float64", "position[rear]", "has no joint names; give the index"),
        ("std_msgs/msg/Float64", "value", "no 'value' in"),
        ("std_msgs/msg/String", "data", "not a number"),
    ],
)
def test_what_cannot_be_written_is_reported(tmp_path, kind, field, phrase):
    with pytest.raises(SignalsError, match=phrase) as caught:
        write_bag(tmp_path / "run", [TopicData("t", kind, np.arange(3), {field: np.zeros(3)})])
    assert "topic t" in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_topic_data_is_checked_at_the_door():
    with pytest.raises(RecordingError, match=r"topic t: data has shape \(2,\); expected \(3,\)"):
        TopicData("t", tiny.FLOAT, np.arange(3), {"data": np.zeros(2)})
    with pytest.raises(RecordingError, match="no times before 0"):
        TopicData("t", tiny.FLOAT, np.arange(-1, 2), {"data": np.zeros(3)})


def test_messages_of_several_topics_are_in_time_order(tmp_path, monkeypatch):
    """A topic begins late, one runs backwards; the messages fill several chunks."""
    monkeypatch.setattr(writer, "CHUNK", 20_000)
    rng = np.random.default_rng(3)
    stamps = [np.sort(rng.integers(0, 10**9, 700)), np.arange(0, 10**9, 10**7), rng.integers(9 * 10**8, 10**9, 60)]
    kinds = {"a": (tiny.FLOAT, "data"), "b": (tiny.WRENCH, "wrench.force.z"), "c": ("std_msgs/msg/Float32", "data")}
    topics = [
        TopicData(name, kind, times, {field: rng.standard_normal(len(times))})
        for times, (name, (kind, field)) in zip(stamps, kinds.items(), strict=True)
    ]
    write_bag(tmp_path / "bag", topics)
    with Reader(tmp_path / "bag") as reader:
        read = [(c.topic, stamp) for c, stamp, _ in reader.messages()]
        counts = {c.topic: c.msgcount for c in reader.connections}
        assert (reader.message_count, reader.start_time) == (860, 0)
        assert reader.end_time == max(int(s.max()) for s in stamps) + 1
    assert counts == {"/a": 700, "/b": 100, "/c": 60}
    assert sorted(read) == sorted((f"/{t.name}", int(s)) for t in topics for s in t.stamps_ns)
    with (tmp_path / "bag" / "bag.mcap").open("rb") as file:
        stored = [(c.topic, m.log_time) for _, c, m in NonSeekingReader(file).iter_messages(log_time_order=False)]
        file.seek(0)
        summary = make_reader(file).get_summary()
    assert summary is not None and len(summary.chunk_indexes) == 7
    order = [
        (int(late), i, int(s))
        for i, t in enumerate(stamps)
        for late, s in zip(np.maximum.accumulate(t), t, strict=True)
    ]
    assert stored == [(f"/{'abc'[i]}", stamp) for _, i, stamp in sorted(order, key=itemgetter(0))]
