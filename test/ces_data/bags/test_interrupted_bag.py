import shutil
import sqlite3
import warnings

import numpy as np
import pytest
import tiny_bags as tiny
import yaml
import zstandard
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from ces_data.bags.reader import list_topics, read_recording
from ces_data.bags.storage import list_data_files
from ces_observer.errors import RecordingError
from ces_observer.signals import Signals

DEFAULT = Signals.from_mapping({}, "defaults")
COUNT = 300
SCALES = {"position": (0.0, 0.001), "current": (0.3, 0.01), "force": (0.0, 10.0)}  # of tiny.drive


def killed(path, storage=StoragePlugin.MCAP, compression=CompressionMode.NONE, start_ns=5 * tiny.SECOND, count=COUNT):
    """A bag without the metadata that a recorder writes when it ends, and its data file."""
    tiny.write(path, tiny.drive(n=count, start_ns=start_ns), storage, compression)
    (path / "metadata.yaml").unlink()
    return path, next(path.iterdir())


def read(path):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = read_recording(path, DEFAULT, ())
    return recording, [str(w.message) for w in caught]


def count_published(recording):
    """Return the number of samples in all channels; they must be the first ones that were published."""
    for name, channel in recording.channels.items():
        offset, scale = SCALES[name]
        np.testing.assert_allclose(channel.values, offset + scale * np.arange(len(channel)), rtol=1e-12)
        np.testing.assert_array_equal(np.diff(channel.stamps_ns), 1_000_000)
    return sum(map(len, recording.channels.values()))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("compression", "count"), [(CompressionMode.NONE, COUNT), (CompressionMode.STORAGE, 10 * COUNT)]
)
def test_mcap_cut_anywhere_is_read_up_to_the_last_whole_message(tmp_path, compression, count):
    path, file = killed(tmp_path / "run", compression=compression, count=count)
    whole, counts = file.read_bytes(), []
    for cut in range(len(whole), 0, -len(whole) // 9):
        file.write_bytes(whole[:cut])
        try:
            recording, texts = read(path)
        except RecordingError as error:
            assert any(phrase in str(error) for phrase in ("no messages", "is not an MCAP file"))
            counts.append(0)
        else:
            counts.append(count_published(recording))
            assert f"{path}: the recorder did not end in order (killed?); the {counts[-1]} messages" in texts[0]
            assert file.read_bytes() == whole[:cut]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] == 3 * count
    assert len(set(counts)) > 3


def test_database_without_metadata(tmp_path):
    path, _ = killed(tmp_path / "run", StoragePlugin.SQLITE3, CompressionMode.MESSAGE)
    recording, texts = read(path)
    assert count_published(recording) == 3 * COUNT
    assert f"the {3 * COUNT} messages that it had stored are read" in texts[0]
    assert list_topics(path)[0].count == COUNT


def test_database_with_a_journal_that_was_not_applied(tmp_path):
    source, file = killed(tmp_path / "source", StoragePlugin.SQLITE3)
    with sqlite3.connect(file) as database:
        last = database.execute("SELECT topic_id, timestamp, data FROM messages WHERE id > 840").fetchall()
        database.execute("DELETE FROM messages WHERE id > 840")
    database.execute("PRAGMA journal_mode = WAL")
    database.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", last)
    database.commit()
    killed_now = tmp_path / "killed"
    shutil.copytree(source, killed_now)
    database.close()
    before = {f.name: f.read_bytes() for f in killed_now.iterdir()}
    assert len(before["source.db3-wal"]) > 1000
    assert count_published(read(killed_now)[0]) == 3 * COUNT
    assert {f.name: f.read_bytes() for f in killed_now.iterdir()} == before


def test_files_are_read_in_recorded_order_and_compressed_ones_once(tmp_path):
    bag = tmp_path / "run"
    bag.mkdir()
    for i in (2, 10, 9):
        _, file = killed(tmp_path / str(i), start_ns=i * tiny.SECOND, count=20)
        raw = file.read_bytes()
        (bag / f"run_{i}.mcap.zstd").write_bytes(zstandard.compress(raw)[: 100 if i == 10 else None])
        if i == 10:
            (bag / f"run_{i}.mcap").write_bytes(raw[: len(raw) - 3000])
    (bag / "run_11.mcap").touch()
    names = [file.name for file in list_data_files(bag)]
    assert names == ["run_2.mcap.zstd", "run_9.mcap.zstd", "run_10.mcap"]
    stamps = read(bag)[0].channel("position").stamps_ns
    assert (np.diff(stamps) > 0).all()
    assert {int(s) for s in stamps // tiny.SECOND} == {2, 9, 10}


def test_only_the_last_file_may_be_cut(tmp_path):
    path, file = killed(tmp_path / "run")
    (path / "run_1.mcap").write_bytes(file.read_bytes())
    file.rename(path / "run_0.mcap")
    (path / "run_0.mcap").write_bytes((path / "run_1.mcap").read_bytes()[:-5000])
    with pytest.raises(RecordingError, match=r"run_0\.mcap: the file ends early"):
        read(path)


def test_metadata_that_was_written_afterwards_must_count_what_is_there(tmp_path):
    """`ros2 bag reindex` writes metadata.yaml; a file that was cut later has fewer messages."""
    path = tiny.write(tmp_path / "run", tiny.drive(n=COUNT))
    file = path / "run.mcap"
    file.write_bytes(file.read_bytes()[:60_000])
    text = (path / "metadata.yaml").read_text()
    (path / "metadata.yaml").unlink()
    there = count_published(read(path)[0])
    for lost in (0, 1):
        content = yaml.safe_load(text)
        content["rosbag2_bagfile_information"]["message_count"] = there + lost
        (path / "metadata.yaml").write_text(yaml.safe_dump(content))
        if not lost:
            assert count_published(read(path)[0]) == there
    with pytest.raises(RecordingError, match=r"ends early.*mcap recover"):
        read(path)
