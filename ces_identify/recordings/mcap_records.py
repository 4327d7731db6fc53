"""MCAP files as blocks of raw messages: whole chunks are decompressed and their records indexed by a compiled scan.

A file without chunks, as `ros2 bag record --storage-preset-profile fastwrite` writes it, takes the same way. A file
that ends early is an error, never a shorter recording. The format: https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
from numba import njit

from ces_identify.recordings.bulk_decode import Block, Bytes, Index
from ces_observer.errors import RecordingError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MAGIC = b"\x89MCAP0\r\n"
FOOTER, MESSAGE, CHUNK, DATA_END = 0x02, 0x05, 0x06, 0x0F
FOOTER_SIZE = 9 + 20 + len(MAGIC)
MESSAGE_HEADER = 22  # channel u16, sequence u32, log time u64, publish time u64
WINDOW = 8 << 20  # bytes of the file held at a time
BLOCK = 4 << 20  # bytes of decompressed records decoded together


def require_complete(path: Path) -> None:
    """Raise RecordingError if the file is no MCAP file or lacks the footer that closes one."""
    size = path.stat().st_size
    if size == 0:
        raise RecordingError(f"{path}: the file is empty; expected an MCAP recording")
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise RecordingError(f"{path}: is not an MCAP file; it does not begin with the bytes {MAGIC!r}")
        file.seek(max(0, size - FOOTER_SIZE))
        tail = file.read()
    if len(tail) < FOOTER_SIZE or tail[0] != FOOTER or not tail.endswith(MAGIC):
        raise truncated(path, size)


def truncated(path: Path, size: int) -> RecordingError:
    """Return the error for a file that ends early, `size` bytes after its start."""
    return RecordingError(
        f"{path}: the file ends early, after {size} bytes and without an MCAP footer (recording interrupted or copy"
        f" incomplete?); copy it again, or save what is there: mcap recover {path.name} -o recovered.mcap"
    )


def blocks(path: Path) -> Iterator[Block]:
    """Yield the messages of a file in the order of the file; raises RecordingError if it ends early or is damaged."""
    held: list[bytes] = []
    for records in _record_runs(path):
        held.append(records)
        if sum(map(len, held)) >= BLOCK:
            yield _block(b"".join(held), path)
            held = []
    if held:
        yield _block(b"".join(held), path)


def _record_runs(path: Path) -> Iterator[bytes]:
    """Yield runs of whole records: the content of each chunk, and the records that stand between chunks."""
    with path.open("rb") as file:
        file.seek(len(MAGIC))
        rest = b""
        while True:
            more = file.read(max(WINDOW, len(rest)))
            if not more:
                raise truncated(path, file.tell())
            data = rest + more
            opcodes, starts, lengths, end = index_records(np.frombuffer(data, dtype=np.uint8))
            closing = np.flatnonzero((opcodes == DATA_END) | (opcodes == FOOTER))
            last = int(closing[0]) if len(closing) else len(opcodes)
            yield from _runs(data, opcodes[:last], starts[:last], lengths[:last], path)
            if len(closing):
                return
            rest = data[end:]


def _runs(data: bytes, opcodes: Bytes, starts: Index, lengths: Index, path: Path) -> Iterator[bytes]:
    """Split the indexed records at the chunks."""
    if not len(opcodes):
        return
    ends = starts + lengths
    begin = 0
    for i in np.flatnonzero(opcodes == CHUNK):
        yield data[begin : starts[i] - 9]
        yield _decompress(data[starts[i] : ends[i]], path)
        begin = int(ends[i])
    yield data[begin : ends[-1]]


def _decompress(chunk: bytes, path: Path) -> bytes:
    """Return the records in a chunk after checking their size and checksum."""
    try:
        size, crc, name_size = struct.unpack_from("<QII", chunk, 16)
        compression = chunk[32 : 32 + name_size].decode()
        (packed_size,) = struct.unpack_from("<Q", chunk, 32 + name_size)
        packed = chunk[40 + name_size : 40 + name_size + packed_size]
        records = _unpack(packed, compression, size)
    except (struct.error, UnicodeDecodeError, zstd.ZstdError, EOFError, RuntimeError) as error:
        raise RecordingError(f"{path}: a chunk is damaged ({error}); copy the file again or use mcap recover") from None
    if len(records) != size or (crc and zlib.crc32(records) != crc):
        raise RecordingError(f"{path}: a chunk is damaged (its checksum or size is wrong); copy the file again")
    return records


def _unpack(packed: bytes, compression: str, size: int) -> bytes:
    """Undo a chunk's compression, to at most one byte more than it should have."""
    if compression == "":
        return packed
    if compression == "zstd":
        return zstd.ZstdDecompressor().decompress(packed, max_length=size + 1)
    if compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1))
    raise struct.error(f"compression '{compression}' is none of zstd and lz4")


def _block(records: bytes, path: Path) -> Block:
    buffer = np.frombuffer(records, dtype=np.uint8)
    opcodes, starts, lengths, end = index_records(buffer)
    messages = opcodes == MESSAGE
    starts, lengths = starts[messages], lengths[messages]
    if end != len(buffer) or (len(lengths) and lengths.min() < MESSAGE_HEADER):
        raise RecordingError(f"{path}: the records in a chunk do not fill it; the file is damaged, copy it again")
    topics = _gather(buffer, starts, "<u2")
    log_ns = _gather(buffer, starts + 6, "<i8")
    return Block(buffer, topics, log_ns, starts + MESSAGE_HEADER, lengths - MESSAGE_HEADER)


def _gather(buffer: Bytes, starts: Index, kind: str) -> Index:
    dtype = np.dtype(kind)
    gathered: Index = buffer[starts[:, None] + np.arange(dtype.itemsize)].view(dtype)[:, 0].astype(np.int64)
    return gathered


def index_records(buffer: Bytes) -> tuple[Bytes, Index, Index, int]:
    """Return opcode, start and length of each whole record in a buffer, shapes (n,), and where the last one ends."""
    room = len(buffer) // 9 + 1
    opcodes, starts, lengths = np.empty(room, np.uint8), np.empty(room, np.int64), np.empty(room, np.int64)
    count, end = _scan(buffer, opcodes, starts, lengths)
    return opcodes[:count].copy(), starts[:count].copy(), lengths[:count].copy(), end


@njit(cache=True, nogil=True)
def _scan(buffer: Bytes, opcodes: Bytes, starts: Index, lengths: Index) -> tuple[int, int]:
    """Fill in opcode, start and length of each whole record: one opcode byte, a u64 length, and so many bytes."""
    count, position, size = 0, 0, len(buffer)
    while position + 9 <= size:
        length = np.uint64(0)
        for i in range(8):
            length |= np.uint64(buffer[position + 1 + i]) << np.uint64(8 * i)
        if length > np.uint64(size - position - 9):
            break
        opcodes[count] = buffer[position]
        starts[count] = position + 9
        lengths[count] = length
        position += 9 + int(length)
        count += 1
    return count, position
