"""Bags whose recorder was killed: what it had stored, up to the last whole message.

`ros2 bag record` writes metadata.yaml, and the summary and footer of an MCAP file, only when it ends in order. The
files themselves say which topics they hold. They are read where they are, or from temporary copies; nothing in the bag
changes.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import zstandard

from ces_identify.recordings import mcap_topics, sqlite_records
from ces_identify.recordings.bag_storage import Bag, DataFile
from ces_identify.recordings.mcap_records import require_complete, require_mcap_file
from ces_observer.errors import RecordingError

SUFFIXES = (".mcap", ".db3")
PACKED = ".zstd"


def list_data_files(path: Path) -> list[Path]:
    """Return the data files of a bag's folder in recorded order; of a file and its compressed copy, the file."""
    found = {file.name: file for file in path.iterdir() if file.name.endswith(SUFFIXES) and file.stat().st_size}
    for file in path.iterdir():
        if file.name.removesuffix(PACKED).endswith(SUFFIXES) and file.name.endswith(PACKED):
            found.setdefault(file.name.removesuffix(PACKED), file)
    return [found[name] for name in sorted(found, key=_by_number)]


def _by_number(name: str) -> list[tuple[int, str]]:
    """Return a key that sorts run_10 after run_9."""
    return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"(\d+)", name)]


@contextmanager
def open_interrupted_bag(path: Path) -> Iterator[Bag]:
    """Open a bag's folder without metadata; raises RecordingError if a file is damaged or any but the last is cut."""
    stored = list_data_files(path)
    with TemporaryDirectory() as folder:
        files = tuple(_open_file(file, Path(folder), last=file == stored[-1]) for file in stored)
        topics = tuple(topic for file in files for topic in file.topics)
        count = sum(topic.count for topic in topics)
        warning = (
            f"{path}: the recorder did not end in order (killed?); the {count} messages that it had stored are read"
        )
        yield Bag(path, topics, files, warning)


def _open_file(file: Path, folder: Path, *, last: bool) -> DataFile:
    path = _decompress(file, folder) if file.suffix == PACKED else file
    if path.suffix == ".db3":
        path, used = _recover_database(path, folder)
        return DataFile(path, used, sqlite_records.list_topics(path))
    (require_mcap_file if last else require_complete)(path)
    return DataFile(path, (file,), mcap_topics.list_topics(path), interrupted=True)


def _decompress(file: Path, folder: Path) -> Path:
    path = folder / file.name.removesuffix(PACKED)
    try:
        with file.open("rb") as packed, path.open("wb") as unpacked:
            zstandard.ZstdDecompressor().copy_stream(packed, unpacked)
    except zstandard.ZstdError as error:
        raise RecordingError(f"{file}: cannot be decompressed: {error}; copy it again") from None
    return path


def _recover_database(path: Path, folder: Path) -> tuple[Path, tuple[Path, ...]]:
    """Return the database and the files it is made of; one with a journal is copied, and its journal applied there."""
    journals = [path.with_name(path.name + ending) for ending in ("-wal", "-journal")]
    used = (path, *(journal for journal in journals if journal.exists() and journal.stat().st_size))
    if len(used) == 1:
        return path, used
    for file in used:
        shutil.copyfile(file, folder / file.name)
    sqlite_records.apply_journal(folder / path.name)
    return folder / path.name, used
