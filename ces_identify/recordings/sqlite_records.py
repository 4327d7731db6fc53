"""SQLite3 storage files (`.db3`) as blocks of raw messages, in recorded order."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from urllib.parse import quote

import numpy as np

from ces_identify.recordings.bulk_decode import Block
from ces_observer.errors import RecordingError

MAGIC = b"SQLite format 3\0"
HEADER_FIELDS = (slice(16, 18), slice(24, 28), slice(28, 32), slice(92, 96))
SELECT = "SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN"
ROWS = 20_000  # messages per block


def require_complete(path: Path) -> None:
    """Raise RecordingError if the file is shorter than its header says; https://sqlite.org/fileformat.html, 1.3."""
    with path.open("rb") as file:
        head = file.read(100)
    if len(head) < 100 or not head.startswith(MAGIC):
        raise RecordingError(f"{path}: is not an SQLite3 file, or ends early; copy the recording again")
    page_size, changes, pages, pages_valid_for = (int.from_bytes(head[at]) for at in HEADER_FIELDS)
    expected = (65_536 if page_size == 1 else page_size) * pages
    if changes == pages_valid_for and path.stat().st_size < expected:
        size = path.stat().st_size
        raise RecordingError(f"{path}: the file ends early, after {size} of {expected} bytes; copy the recording again")


def blocks(path: Path, topics: Sequence[int]) -> Iterator[Block]:
    """Yield the messages of these topics; raises RecordingError if the database is damaged or truncated."""
    require_complete(path)
    uri = f"file:{quote(str(path.resolve()))}?mode=ro"
    try:
        with closing(sqlite3.connect(uri, uri=True)) as database:
            rows = database.execute(f"{SELECT} ({','.join('?' * len(topics))}) ORDER BY id", topics)
            while batch := rows.fetchmany(ROWS):
                yield _block(batch)
    except sqlite3.Error as error:
        raise RecordingError(f"{path}: {error}; the recording is damaged or incomplete, copy it again") from None


def _block(batch: list[tuple[int, int, bytes]]) -> Block:
    topics, log_ns, payloads = zip(*batch, strict=True)
    return Block.join(payloads, np.array(topics, np.int64), np.array(log_ns, np.int64))
