"""SQLite3 storage files (`.db3`): their topics, and their messages as blocks in recorded order."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from urllib.parse import quote

from ces_data.bags.decode import Block, StoredTopic, make_definition
from ces_observer.errors import RecordingError

MAGIC = b"SQLite format 3\0"
HEADER_FIELDS = (slice(16, 18), slice(24, 28), slice(28, 32), slice(92, 96))
SELECT = "SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN"
TOPICS = "SELECT id, name, type, serialization_format FROM topics"
COUNTS = "SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id"
DEFINITIONS = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
HAS_DEFINITIONS = "SELECT COUNT(*) FROM sqlite_master WHERE name = 'message_definitions'"  # since Iron
ROWS = 20_000  # messages per block
_DAMAGE = (
    "{path}: {error}; the recording is damaged or incomplete: copy it again, or save what is there: "
    "sqlite3 {name} .recover | sqlite3 recovered.db3"
)


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
    with _reading(path) as database:
        rows = database.execute(f"{SELECT} ({','.join('?' * len(topics))}) ORDER BY id", topics)
        while batch := rows.fetchmany(ROWS):
            numbers, log_ns, payloads = zip(*batch, strict=True)
            yield Block.join(payloads, numbers, log_ns)


def list_topics(path: Path) -> tuple[StoredTopic, ...]:
    """Return the topics of a file; raises RecordingError if the database is damaged."""
    with _reading(path) as database:
        counts = dict(database.execute(COUNTS).fetchall())
        known = database.execute(HAS_DEFINITIONS).fetchone()[0]
        defined = {kind: (form, text) for kind, form, text in database.execute(DEFINITIONS)} if known else {}
        topics = database.execute(TOPICS).fetchall()
    return tuple(
        StoredTopic(i, name, kind, make_definition(*defined.get(kind, ("", ""))), encoding, counts.get(i, 0))
        for i, name, kind, encoding in topics
    )


def apply_journal(path: Path) -> None:
    """Complete a copied database with the journal beside it; raises RecordingError if that cannot be done."""
    try:
        with closing(sqlite3.connect(path)) as database:
            database.execute("PRAGMA journal_mode = DELETE").fetchall()
    except sqlite3.Error as error:
        raise RecordingError(_DAMAGE.format(path=path, name=path.name, error=error)) from None


@contextmanager
def _reading(path: Path) -> Iterator[sqlite3.Connection]:
    try:
        with closing(sqlite3.connect(f"file:{quote(str(path.resolve()))}?mode=ro", uri=True)) as database:
            yield database
    except sqlite3.Error as error:
        raise RecordingError(_DAMAGE.format(path=path, name=path.name, error=error)) from None
