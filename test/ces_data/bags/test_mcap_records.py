import shutil
import sqlite3
import struct
import tracemalloc
import warnings
from io import BytesIO

import lz4.frame
import numpy as np
import pytest
import tiny_bags as tiny
import yaml
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.writer import MCAP0_MAGIC, CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from ces_data.bags import mcap
from ces_data.bags.mcap import blocks, split_messages
from ces_data.bags.reader import list_topics, read_recording
from ces_data.bags.storage import list_data_files
from ces_observer.errors import RecordingError
from ces_observer.signals import Signals


def slow_twin(data):
    """Walk along the records one after the other, as the format's description reads."""
    rows, stream = [], BytesIO(data)
    while len(head := stream.read(9)) == 9:
        opcode, length = struct.unpack("<BQ", head)
        start = stream.tell()
        body = stream.read(length)
        if len(body) < length or (opcode == 5 and length < 22):
            return rows, start - 9
        if opcode == 5:
            channel, _, log_ns, _ = struct.unpack("<HIqQ", body[:22])
            rows.append((channel, log_ns, start + 22, length - 22))
    return rows, stream.tell() - len(head)


def split(data):
    messages, end = split_messages(np.frombuffer(data, dtype=np.uint8))
    return [tuple(row) for row in messages.tolist()], end


def record(opcode, body):
    return struct.pack("<BQ", opcode, len(body)) + body


def test_split_is_that_of_the_slow_twin():
    rng = np.random.default_rng(2)
    data = b"".join(record(int(rng.integers(1, 15)), rng.bytes(rng.integers(22, 300))) for _ in range(200))
    for cut in (0, 1, 9, 12, 400):
        part = data[: len(data) - cut]
        assert split(part) == slow_twin(part) and len(split(part)[0]) > 5
    data = record(5, bytes(22)) + b"\x05" + b"\xff" * 8 + b"x"  # a length beyond all memory is an unfinished record
    assert split(data) == ([(0, 0, 31, 0)], 31)
    data = record(3, b"abc") + record(5, bytes(21)) + record(5, bytes(22))  # too short for its header
    assert split(data) == slow_twin(data) == ([], 12)


def write(path, messages, **options):
    with path.open("wb") as file:
        writer = McapWriter(file, **options)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data\n")
        channels = [writer.register_channel(topic, "cdr", schema) for topic in ("/a", "/b")]
        for channel, log_ns, payload in messages:
            writer.add_message(channels[channel], log_ns, payload, log_ns)
        writer.finish()
    return channels


WAYS = {
    "zstd": {"compression": CompressionType.ZSTD, "chunk_size": 2000},
    "lz4": {"compression": CompressionType.LZ4, "chunk_size": 2000},
    "none": {"compression": CompressionType.NONE, "chunk_size": 2000},
    "one message a chunk": {"compression": CompressionType.NONE, "chunk_size": 1},
    "no chunks": {"use_chunking": False},
    "no index": {"index_types": IndexType.NONE, "use_statistics": False, "use_summary_offsets": False},
}


@pytest.mark.parametrize("way", WAYS)
def test_every_way_of_storing_gives_the_messages_in_recorded_order(tmp_path, monkeypatch, way):
    rng = np.random.default_rng(4)
    messages = [(int(rng.integers(2)), int(rng.integers(10**15)), rng.bytes(rng.integers(0, 90))) for _ in range(400)]
    channels = write(tmp_path / "x.mcap", messages, **WAYS[way])
    for size in (64, 3000, 4 << 20):
        monkeypatch.setattr(mcap, "BLOCK", size)
        rows = [
            (channels.index(int(block.topics[i])), int(block.log_ns[i]), block.payload(i))
            for block in blocks(tmp_path / "x.mcap")
            for i in range(len(block))
        ]
        assert rows == messages


def test_footer_pasted_onto_a_cut_file_does_not_hide_the_cut(tmp_path):
    path = tmp_path / "x.mcap"
    write(path, [(0, i, bytes(3000)) for i in range(50)], use_chunking=False)
    whole = path.read_bytes()
    path.write_bytes(whole[:9000] + whole[-37:])
    with pytest.raises(RecordingError, match=r"ends early"):
        list(blocks(path))


@pytest.mark.parametrize("way", ["zstd", "none"])
def test_damaged_chunk_is_never_read(tmp_path, way):
    path = tmp_path / "x.mcap"
    rng = np.random.default_rng(5)
    write(path, [(0, i, rng.bytes(30)) for i in range(400)], **WAYS[way])
    whole = bytearray(path.read_bytes())
    with path.open("rb") as file:
        second = make_reader(file).get_summary().chunk_indexes[1]
    whole[second.chunk_start_offset + second.chunk_length * 3 // 4] ^= 0x10
    path.write_bytes(whole)
    with pytest.raises(RecordingError, match="damaged"):
        list(blocks(path))


BOMB = {"zstd": zstandard.compress(bytes(50_000_000)), "lz4": lz4.frame.compress(bytes(1_000_000)), "": bytes(101)}


@pytest.mark.parametrize("compression", BOMB)
def test_chunk_with_more_data_than_it_states_is_refused(tmp_path, compression):
    chunk = Chunk(compression, BOMB[compression], 0, 0, 0, uncompressed_size=100)
    tracemalloc.start()
    assert "a chunk is damaged" in refusal(tmp_path / "x.mcap", chunk)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10_000_000
    assert "compression 'br' is none of zstd and lz4" in refusal(tmp_path / "x.mcap", Chunk("br", b"abc", 0, 0, 0, 3))


@pytest.mark.parametrize("stated", [10**6, 2**64 - 1])
@pytest.mark.parametrize("at", [1, 9 + 32])  # length of the record, length of the data in it
def test_length_beyond_the_file_is_refused(tmp_path, stated, at):
    path = tmp_path / "x.mcap"
    refusal(path, Chunk("", bytes(100), 0, 0, 1, 100))
    whole = bytearray(path.read_bytes())
    whole[8 + at : 16 + at] = struct.pack("<Q", stated)
    path.write_bytes(whole)
    with pytest.raises(RecordingError, match=r"a chunk is damaged|the file ends early"):
        list(blocks(path))


def refusal(path, chunk):
    """Return the error about a file with this chunk alone."""
    builder = RecordBuilder()
    chunk.write(builder)
    path.write_bytes(MCAP0_MAGIC + builder.end() + record(Opcode.DATA_END, bytes(4)))
    with pytest.raises(RecordingError) as caught:
        list(blocks(path))
    return str(caught.value)


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
