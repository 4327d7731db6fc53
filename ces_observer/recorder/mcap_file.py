"""An MCAP file written message by message: chunks without compression, each indexed, and a summary at the end.

The format is https://mcap.dev/spec, profile `ros2`; Foxglove, PlotJuggler, rosbags, rosbag2 and `mcap info` read it.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

from ces_observer import __version__

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
STATISTICS, SUMMARY_OFFSET, DATA_END = 0x0B, 0x0E, 0x0F
MOST_NS = (1 << 64) - 1
CHUNK_BYTES = 1 << 16  # a chunk is written when it is this full: small, so that ending one takes little time
_PREFIX = struct.Struct("<BQ")  # opcode, length
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_INDEX_ENTRY = struct.Struct("<QQ")  # log time, offset in the chunk


@dataclass(frozen=True)
class BagChannel:
    """A topic of a bag: its resolved name, message type, that type's `ros2msg` definition and, if known, its hash."""

    topic: str
    type: str
    definition: str
    type_hash: str = ""


class McapFile:
    """Writes one file; raises OSError where the file system does. `close` makes it complete.

    `counts` holds the number of messages of each channel, `start_ns` and `end_ns` their earliest and latest time.
    """

    def __init__(self, path: Path, channels: Sequence[BagChannel]) -> None:
        self.counts = [0] * len(channels)
        self.start_ns = self.end_ns = 0
        self._file = path.open("xb")
        self._size = 0
        self._definitions = _definitions(channels)
        self._chunk_indices: list[bytes] = []
        self._chunk, self._index = BytesIO(), dict[int, bytearray]()
        self._first_ns, self._last_ns = MOST_NS, 0  # of the chunk
        self._put(MAGIC + _record(HEADER, _text("ros2") + _text(f"ces_observer {__version__}")))
        self._put(b"".join(self._definitions))

    def write(self, channel: int, log_ns: int, raw: bytes) -> None:
        """Write a message of a channel, given by its place among `channels`, that was received at `log_ns` >= 0."""
        chunk = self._chunk
        if channel not in self._index:
            self._index[channel] = bytearray()
        self._index[channel] += _INDEX_ENTRY.pack(log_ns, chunk.tell())
        self._first_ns, self._last_ns = min(self._first_ns, log_ns), max(self._last_ns, log_ns)
        chunk.write(_MESSAGE.pack(MESSAGE, 22 + len(raw), channel, self.counts[channel], log_ns, log_ns))
        chunk.write(raw)
        self.counts[channel] += 1
        if chunk.tell() >= CHUNK_BYTES:
            self._end_chunk()

    def close(self) -> None:
        """Write what is left and the summary, and close the file; further calls do nothing."""
        if self._file.closed:
            return
        with self._file:
            if self._index:
                self._end_chunk()
            self._put(_record(DATA_END, struct.pack("<I", 0)))
            self._put(self._summary())
            self._file.flush()

    def abandon(self) -> None:
        """Close the file as it is."""
        self._file.close()

    def _put(self, data: bytes) -> None:
        self._file.write(data)
        self._size += len(data)

    def _end_chunk(self) -> None:
        """Write the chunk and an index of its messages, and keep where they are for the summary."""
        records, times = self._chunk.getvalue(), (self._first_ns, self._last_ns)
        self.start_ns = min(times[0], self.start_ns) if self._chunk_indices else times[0]
        self.end_ns = max(times[1], self.end_ns)
        head = struct.pack("<QQQI", *times, len(records), zlib.crc32(records)) + _text("")
        chunk = _record(CHUNK, head + struct.pack("<Q", len(records)) + records)
        begin, place = self._size, self._size + len(chunk)
        indices, places = [], []
        for channel, entries in self._index.items():
            indices.append(_record(MESSAGE_INDEX, struct.pack("<H", channel) + _sized(entries)))
            places.append(struct.pack("<HQ", channel, place))
            place += len(indices[-1])
        self._put(chunk + b"".join(indices))
        where = struct.pack("<QQQQ", *times, begin, len(chunk)) + _sized(b"".join(places))
        sizes = struct.pack("<Q", place - begin - len(chunk)) + _text("") + struct.pack("<QQ", *[len(records)] * 2)
        self._chunk_indices.append(_record(CHUNK_INDEX, where + sizes))
        self._chunk, self._index = BytesIO(), {}
        self._first_ns, self._last_ns = MOST_NS, 0

    def _summary(self) -> bytes:
        """Return summary, summary offsets and footer, to stand at the file's end."""
        schemas = [one for one in self._definitions if one[0] == SCHEMA]
        channels = [one for one in self._definitions if one[0] == CHANNEL]
        start, groups, offsets = self._size, b"", b""
        for group in (schemas, channels, self._chunk_indices, [self._statistics(len(schemas))]):
            if group:
                joined = b"".join(group)
                offsets += _record(SUMMARY_OFFSET, struct.pack("<BQQ", group[0][0], start + len(groups), len(joined)))
                groups += joined
        footer = _PREFIX.pack(FOOTER, 20) + struct.pack("<QQ", start, start + len(groups))
        checksum = zlib.crc32(groups + offsets + footer)
        return groups + offsets + footer + struct.pack("<I", checksum) + MAGIC

    def _statistics(self, schemas: int) -> bytes:
        counts = b"".join(struct.pack("<HQ", channel, count) for channel, count in enumerate(self.counts))
        figures = (sum(self.counts), schemas, len(self.counts), 0, 0, len(self._chunk_indices))
        times = (self.start_ns, self.end_ns)
        return _record(STATISTICS, struct.pack("<QHIIIIQQ", *figures, *times) + _sized(counts))


def _definitions(channels: Sequence[BagChannel]) -> list[bytes]:
    """Return the records that define the channels and, each before its first channel, their schemas."""
    records: list[bytes] = []
    schemas: dict[str, int] = {}
    for number, channel in enumerate(channels):
        if channel.type not in schemas:
            schemas[channel.type] = len(schemas) + 1
            body = _text(channel.type) + _text("ros2msg") + _text(channel.definition)
            records.append(_record(SCHEMA, struct.pack("<H", schemas[channel.type]) + body))
        facts = {"offered_qos_profiles": "[]", "topic_type_hash": channel.type_hash}
        body = _text(channel.topic) + _text("cdr") + _map(facts)
        records.append(_record(CHANNEL, struct.pack("<HH", number, schemas[channel.type]) + body))
    return records


def _record(opcode: int, body: bytes) -> bytes:
    return _PREFIX.pack(opcode, len(body)) + body


def _sized(data: bytes | bytearray) -> bytes:
    return struct.pack("<I", len(data)) + data


def _text(text: str) -> bytes:
    return _sized(text.encode())


def _map(texts: Mapping[str, str]) -> bytes:
    return _sized(b"".join(_text(key) + _text(value) for key, value in texts.items()))
