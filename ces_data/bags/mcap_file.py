"""Writes an MCAP file chunk by chunk with its indexes; the records are those of the mcap library."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from typing import BinaryIO

import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from ces_data.bags.decode import Bytes, Index
from ces_observer import __version__


class McapFile:
    """An MCAP file of ROS 2 that is being written: its channels first, then chunks of messages, then `finish`."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._builder, self._compressor = file, RecordBuilder(), zstandard.ZstdCompressor()
        self._schemas: dict[str, records.Schema] = {}
        self._channels: list[records.Channel] = []
        self._chunks: list[records.ChunkIndex] = []
        self.counts: dict[int, int] = {}
        file.write(MCAP0_MAGIC)
        self._write(records.Header("ros2", f"ces_observer {__version__}"))

    def add_channel(self, topic: str, kind: str, definition: str) -> int:
        """Return the number of a new channel for messages of the type `kind`, as its .msg `definition` says."""
        if kind not in self._schemas:
            self._schemas[kind] = records.Schema(len(self._schemas) + 1, definition.encode(), "ros2msg", kind)
            self._write(self._schemas[kind])
        number = len(self._channels) + 1
        channel = records.Channel(number, topic, "cdr", {"offered_qos_profiles": "[]"}, self._schemas[kind].id)
        self._channels.append(channel)
        self.counts[number] = 0
        self._write(channel)
        return number

    def write_chunk(self, buffer: Bytes, messages: Mapping[int, tuple[Index, Index]]) -> None:
        """Write a chunk of message records; `messages` has the log times [ns] and offsets of each channel."""
        times = [log_ns for log_ns, _ in messages.values() if len(log_ns)]
        first, last = (int(f([f(one) for one in times])) for f in (np.min, np.max))
        data, at = self._compressor.compress(buffer.data), self._file.tell()
        length = self._write(records.Chunk("zstd", data, last, first, zlib.crc32(buffer.data), len(buffer)))
        offsets: dict[int, int] = {}
        for channel, (log_ns, starts) in messages.items():
            if len(log_ns):
                offsets[channel] = self._file.tell()
                entries = np.stack([log_ns, starts], axis=1).astype("<u8").tobytes()
                self._file.write(
                    struct.pack("<BQHI", Opcode.MESSAGE_INDEX, len(entries) + 6, channel, len(entries)) + entries
                )
                self.counts[channel] += len(log_ns)
        indexes = self._file.tell() - at - length
        self._chunks.append(
            records.ChunkIndex(length, at, "zstd", len(data), last, indexes, offsets, first, len(buffer))
        )

    @property
    def span_ns(self) -> tuple[int, int]:
        """The first and last log time [ns], (0, 0) without messages."""
        firsts, lasts = ([getattr(c, f"message_{end}_time") for c in self._chunks] for end in ("start", "end"))
        return min(firsts, default=0), max(lasts, default=0)

    def finish(self, metadata: str) -> None:
        """Write the bag's metadata, the summary and the footer."""
        at = self._file.tell()
        stored = records.MetadataIndex(
            at, self._write(records.Metadata("rosbag2", {"serialized_metadata": metadata})), "rosbag2"
        )
        self._write(records.DataEnd(0))
        (first, last), sizes = self.span_ns, (len(self._schemas), len(self._channels), len(self._chunks))
        statistics = records.Statistics(
            0, sizes[1], self.counts, sizes[2], sum(self.counts.values()), last, first, 1, sizes[0]
        )
        groups: dict[int, Sequence[records.McapRecord]] = {
            Opcode.SCHEMA: list(self._schemas.values()),
            Opcode.CHANNEL: self._channels,
            Opcode.CHUNK_INDEX: self._chunks,
            Opcode.METADATA_INDEX: [stored],
            Opcode.STATISTICS: [statistics],
        }
        summary, offsets = self._file.tell(), []
        for opcode, group in groups.items():
            start = self._file.tell()
            offsets += [records.SummaryOffset(opcode, start, sum(map(self._write, group)))] if group else []
        footer = records.Footer(summary, self._file.tell(), 0)
        for record in (*offsets, footer):
            self._write(record)
        self._file.write(MCAP0_MAGIC)

    def _write(self, record: records.McapRecord) -> int:
        """Write a record; return its length."""
        record.write(self._builder)
        data: bytes = self._builder.end()  # type: ignore[no-untyped-call]
        return self._file.write(data)
