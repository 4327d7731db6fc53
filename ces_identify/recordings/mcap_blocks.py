"""MCAP files written in blocks: rosbags writes the file's frame and indices, numpy the messages of a whole chunk.

One message after the other, rosbags takes about 4 microseconds for each.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Writer
from rosbags.rosbag2.storage_mcap import McapWriter

from ces_identify.recordings.recording import Stamps

CHUNK_BYTES = 1 << 20
MESSAGE = 5  # opcode
HEAD = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("number", "<u4"), ("logged", "<u8"), ("sent", "<u8")]
)
Rows = NDArray[np.uint8]


@dataclass(frozen=True)
class MessageBlock:
    """Messages of one connection: stamps [ns], int64 (n,), what they are merged by, and payloads, uint8 (n, size)."""

    connection: Connection
    stamps_ns: Stamps
    order_ns: Stamps
    payloads: Rows

    def records(self) -> Rows:
        """Return the messages as records of an MCAP file, uint8 (n, 31 + size)."""
        head = np.zeros(len(self.stamps_ns), dtype=HEAD)
        head["opcode"], head["channel"] = MESSAGE, self.connection.id
        head["length"] = HEAD.itemsize - 9 + self.payloads.shape[1]  # of what follows the length
        head["logged"] = head["sent"] = self.stamps_ns
        return np.hstack([head.view(np.uint8).reshape(len(head), HEAD.itemsize), self.payloads])


def find_windows(order: Sequence[Stamps], sizes: Sequence[int]) -> Iterator[tuple[slice, ...]]:
    """Yield the rows of each topic that follow next in time, of about CHUNK_BYTES together; messages have `sizes`.

    `order` are the non-decreasing times of the topics' messages; equal times are in one window.
    """
    count = max(1, CHUNK_BYTES // max(1, sum(size + HEAD.itemsize for size in sizes)))
    begins = [0] * len(order)
    while rest := [one[begin:] for one, begin in zip(order, begins, strict=True) if begin < len(one)]:
        until = min(one[min(count, len(one)) - 1] for one in rest)
        ends = [int(np.searchsorted(one, until, side="right")) for one in order]
        yield tuple(map(slice, begins, ends))
        begins = ends


def write_blocks(writer: Writer, blocks: Sequence[MessageBlock]) -> None:
    """Write the messages of blocks, at least one of each, as one chunk.

    They are in the order of `order_ns`, at equal times in that of the blocks.
    """
    storage = writer.storage
    assert isinstance(storage, McapWriter)
    records = [block.records() for block in blocks]
    starts, data = _merge([block.order_ns for block in blocks], records)
    first, last = _limits(blocks)
    begin = storage.chunk.bio.tell()
    storage.chunk.bio.write(data)
    for block, mine in zip(blocks, starts, strict=True):
        number, count = block.connection.id, len(block.stamps_ns)
        storage.chunk.msgs[number] = list(zip(block.stamps_ns.tolist(), (mine + begin).tolist(), strict=True))
        storage.channel_stats[number] += count
        writer.counts[number] += count
    for part in (storage, storage.chunk):
        part.message_start_time = min(first, part.message_start_time)
        part.message_end_time = max(last, part.message_end_time)
    writer.min_timestamp, writer.max_timestamp = min(first, writer.min_timestamp), max(last, writer.max_timestamp)
    storage.close_chunk()


def _limits(blocks: Sequence[MessageBlock]) -> tuple[int, int]:
    """Return the smallest and the largest stamp."""
    return min(int(b.stamps_ns.min()) for b in blocks), max(int(b.stamps_ns.max()) for b in blocks)


def _merge(order: Sequence[Stamps], records: Sequence[Rows]) -> tuple[list[NDArray[np.int64]], bytes]:
    """Return where each record of each block begins, and the bytes of all records in order."""
    sizes = np.repeat([one.shape[1] for one in records], [len(one) for one in records])
    rank = np.argsort(np.concatenate(order), kind="stable")
    starts = np.empty(len(rank), dtype=np.int64)
    starts[rank] = np.cumsum(sizes[rank]) - sizes[rank]
    split = np.split(starts, np.cumsum([len(one) for one in records])[:-1])
    data = np.empty(int(sizes.sum()), dtype=np.uint8)
    for mine, rows in zip(split, records, strict=True):
        data[mine[:, None] + np.arange(rows.shape[1])] = rows
    return split, data.tobytes()
