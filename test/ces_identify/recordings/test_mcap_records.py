import struct
from io import BytesIO

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter

from ces_identify.recordings import mcap_records
from ces_identify.recordings.mcap_records import blocks, index_records, require_complete
from ces_observer.errors import RecordingError


def slow_twin(data):
    """Index records one after the other, as the format's description reads."""
    found, stream = [], BytesIO(data)
    while len(head := stream.read(9)) == 9:
        opcode, length = struct.unpack("<BQ", head)
        start = stream.tell()
        if len(stream.read(length)) < length:
            return found, start - 9
        found.append((opcode, start, length))
    return found, stream.tell() - len(head)


def record(opcode, body):
    return struct.pack("<BQ", opcode, len(body)) + body


@pytest.mark.parametrize("cut", [0, 1, 5, 9, 12])
def test_index_is_that_of_the_slow_twin(cut):
    rng = np.random.default_rng(2)
    data = b"".join(record(int(rng.integers(1, 15)), rng.bytes(rng.integers(0, 300))) for _ in range(200))
    data = data[: len(data) - cut]
    opcodes, starts, lengths, end = index_records(np.frombuffer(data, dtype=np.uint8))
    found = list(zip(opcodes.tolist(), starts.tolist(), lengths.tolist(), strict=True))
    assert (found, end) == slow_twin(data)


def test_length_beyond_all_memory_is_an_unfinished_record():
    data = record(5, b"abc") + b"\x05" + b"\xff" * 8 + b"x"
    *_, end = index_records(np.frombuffer(data, dtype=np.uint8))
    assert end == 12


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


@pytest.mark.parametrize("window", [64, 1000, 8 << 20])
@pytest.mark.parametrize("way", WAYS)
def test_every_way_of_storing_gives_the_messages_in_recorded_order(tmp_path, monkeypatch, way, window):
    monkeypatch.setattr(mcap_records, "WINDOW", window)
    monkeypatch.setattr(mcap_records, "BLOCK", 3000)
    rng = np.random.default_rng(4)
    messages = [(int(rng.integers(2)), int(rng.integers(10**15)), rng.bytes(rng.integers(0, 90))) for _ in range(400)]
    channels = write(tmp_path / "x.mcap", messages, **WAYS[way])
    found = [
        (channels.index(int(block.topics[i])), int(block.log_ns[i]), block.payload(i))
        for block in blocks(tmp_path / "x.mcap")
        for i in range(len(block))
    ]
    assert found == messages


@pytest.mark.parametrize("way", ["zstd", "no chunks"])
def test_file_cut_anywhere_is_reported_as_cut(tmp_path, way):
    path = tmp_path / "x.mcap"
    write(path, [(0, i, bytes(30)) for i in range(50)], **WAYS[way])
    whole = path.read_bytes()
    require_complete(path)
    for size in range(1, len(whole), 7):
        path.write_bytes(whole[:size])
        with pytest.raises(RecordingError, match=r"ends early|not an MCAP file") as caught:
            require_complete(path)
        assert size < 8 or "mcap recover x.mcap" in str(caught.value)


def test_footer_pasted_onto_a_cut_file_does_not_hide_the_cut(tmp_path):
    path = tmp_path / "x.mcap"
    write(path, [(0, i, bytes(3000)) for i in range(50)], use_chunking=False)
    whole = path.read_bytes()
    path.write_bytes(whole[:9000] + whole[-37:])
    with pytest.raises(RecordingError, match=r"ends early"):
        list(blocks(path))


@pytest.mark.parametrize("way", ["zstd", "lz4", "none"])
def test_damaged_chunk_is_never_read(tmp_path, way):
    path = tmp_path / "x.mcap"
    rng = np.random.default_rng(5)
    write(path, [(0, i, rng.bytes(30)) for i in range(400)], **WAYS[way])
    whole = bytearray(path.read_bytes())
    opcodes, starts, lengths, _ = index_records(np.frombuffer(bytes(whole[8:]), dtype=np.uint8))
    second = np.flatnonzero(opcodes == mcap_records.CHUNK)[1]
    whole[8 + int(starts[second] + lengths[second] * 3 // 4)] ^= 0x10
    path.write_bytes(whole)
    with pytest.raises(RecordingError, match="damaged"):
        list(blocks(path))


def test_empty_file(tmp_path):
    (tmp_path / "x.mcap").touch()
    with pytest.raises(RecordingError, match="the file is empty"):
        require_complete(tmp_path / "x.mcap")
