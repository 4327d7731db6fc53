"""Opens bags: finished ones with the metadata and definitions that rosbags reads, and those of a killed recorder.

`ros2 bag record` writes metadata.yaml, and the summary and footer of an MCAP file, only when it ends in order. The
files themselves say which topics they hold. They are read where they are, or from temporary copies; nothing in the bag
changes.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import yaml
import zstandard
from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.rosbag2 import Reader

from ces_data.bags import mcap, rosbag1, sqlite
from ces_data.bags.decode import StoredTopic
from ces_data.bags.storage import Bag, DataFile
from ces_data.config_file import first_line
from ces_data.log_formats import explain_import, is_foreign
from ces_observer.errors import RecordingError

METADATA = "metadata.yaml"
SUFFIXES = (".mcap", ".db3")
PACKED = ".zstd"
WRITTEN_BY = "written_by"  # note of every bag of `writer`, whose log times are the samples' stamps
WRITER_NOTES = {WRITTEN_BY, "ces_rig", "imported_from", "model_sha256"}  # the other ones are of earlier versions


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a rosbag2 folder, an `.mcap` or `.db3` file, or a ROS 1 `.bag` file.

    A folder without metadata.yaml is that of a recorder that was killed. With metadata.yaml (`ros2 bag reindex` writes
    one), an unfinished file is read if it has all messages. Raises RecordingError if a bag is damaged or truncated.
    """
    if not path.exists():
        raise RecordingError(f"{path}: no such file or folder; expected a rosbag2 folder or an .mcap file")
    if is_foreign(path):
        raise RecordingError(f"{path}: {explain_import(path)}")
    with ExitStack() as opened:
        yield _open(path, opened)


def _open(path: Path, opened: ExitStack) -> Bag:
    if path.is_dir() and not (path / METADATA).exists():
        _require_data(path)
        return opened.enter_context(open_interrupted_bag(path))
    if path.suffix == rosbag1.SUFFIX and path.is_file():
        topics = rosbag1.list_topics(path)
        return Bag(path, topics, (DataFile(path, (path,), topics),))
    try:
        reader = Reader(path)
        reader.open()
    except Exception as error:  # a damaged file makes rosbags raise errors of any kind
        if path.is_dir() and (bag := _open_reindexed(path, opened)):
            return bag
        for file in path.glob("*.mcap") if path.is_dir() else [path]:
            if file.suffix == ".mcap":
                mcap.require_complete(file)
                _require_ros2(file)
        raise RecordingError(f"{path}: cannot be opened as a bag: {first_line(error).rstrip('.')}") from None
    opened.callback(reader.close)
    storages: list[Any] = getattr(reader.storage, "storages", [reader.storage])
    files = tuple(
        DataFile(storage.path, (_find_stored_file(path, storage.path),), _stored_topics(storage.connections))
        for storage in storages
    )
    notes = _read_metadata(path).get("custom_data") if path.is_dir() else None
    exact = isinstance(notes, dict) and not WRITER_NOTES.isdisjoint(notes)
    return Bag(path, _stored_topics(reader.connections), files, exact_log_times=exact)


def _require_data(path: Path) -> None:
    """Raise RecordingError if a folder without metadata has no data."""
    if list_data_files(path):
        return
    if any(path.glob("*.mcap")):
        raise RecordingError(
            f"{path}: the recorder was killed before its first chunk was stored; nothing can be recovered: record again"
            " (--storage-preset-profile fastwrite stores each message at once)"
        )
    raise RecordingError(f"{path}: the folder has no {METADATA} and no .mcap or .db3 file; expected a bag")


def _read_metadata(path: Path) -> Any:
    return yaml.safe_load((path / METADATA).read_text())["rosbag2_bagfile_information"]


def _open_reindexed(path: Path, opened: ExitStack) -> Bag | None:
    """Return the bag with an unfinished file if it has as many messages as its metadata say, else None."""
    try:
        stated = _read_metadata(path)["message_count"]
        bag = opened.enter_context(open_interrupted_bag(path))
    except (RecordingError, OSError, ValueError, yaml.YAMLError, KeyError, TypeError):
        return None
    return bag if sum(topic.count for topic in bag.topics) == stated else None


def _stored_topics(connections: Iterable[Connection]) -> tuple[StoredTopic, ...]:
    def encoding(connection: Connection) -> str:
        return cast(ConnectionExtRosbag2, connection.ext).serialization_format

    return tuple(StoredTopic(c.id, c.topic, c.msgtype, c.msgdef, encoding(c), c.msgcount) for c in connections)


def _find_stored_file(path: Path, file: Path) -> Path:
    """Return the file in the bag; for a file compressed as a whole, `file` is a temporary copy."""
    packed = path / f"{file.name}.zstd"
    return packed if path.is_dir() and file.parent != path and packed.exists() else file


def _require_ros2(file: Path) -> None:
    """Raise RecordingError if topics of a complete MCAP file are encoded in another way than ROS 2 does."""
    topics = mcap.list_topics(file)
    others = [topic for topic in topics if topic.encoding != "cdr"]
    if not others:
        return
    codes = ", ".join(sorted({f"'{topic.encoding}'" for topic in others}))
    names = ", ".join(sorted({topic.name for topic in others})[:3])
    if len(others) < len(topics):
        raise RecordingError(
            f"{file}: topics ({names}) are encoded as {codes}; expected ROS 2's cdr in all: keep the others alone, "
            "with mcap filter"
        )
    raise RecordingError(
        f"{file}: an MCAP file, but not of ROS 2: its messages ({names}) are encoded as {codes}, expected cdr; write "
        "their numbers as a CSV table, and convert that: ces import TABLE.csv --out BAG"
    )


def list_data_files(path: Path) -> list[Path]:
    """Return the data files of a bag's folder in recorded order; of a file and its compressed copy, the file."""
    found = {file.name: file for file in path.iterdir() if file.name.endswith(SUFFIXES) and file.stat().st_size}
    for file in path.iterdir():
        if file.name.removesuffix(PACKED).endswith(SUFFIXES) and file.name.endswith(PACKED):
            found.setdefault(file.name.removesuffix(PACKED), file)

    def by_number(name: str) -> list[tuple[int, str]]:  # run_10 after run_9
        return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"(\d+)", name)]

    return [found[name] for name in sorted(found, key=by_number)]


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
    path = file
    if file.suffix == PACKED:
        path = folder / file.name.removesuffix(PACKED)
        try:
            with file.open("rb") as packed, path.open("wb") as unpacked:
                zstandard.ZstdDecompressor().copy_stream(packed, unpacked)
        except zstandard.ZstdError as error:
            raise RecordingError(f"{file}: cannot be decompressed: {error}; copy it again") from None
    if path.suffix == ".db3":
        path, used = _recover_database(path, folder)
        return DataFile(path, used, sqlite.list_topics(path))
    (mcap.require_mcap_file if last else mcap.require_complete)(path)
    return DataFile(path, (file,), mcap.list_topics(path), interrupted=True)


def _recover_database(path: Path, folder: Path) -> tuple[Path, tuple[Path, ...]]:
    """Return the database and the files it is made of; one with a journal is copied, and its journal applied there."""
    journals = [path.with_name(path.name + ending) for ending in ("-wal", "-journal")]
    used = (path, *(journal for journal in journals if journal.exists() and journal.stat().st_size))
    if len(used) == 1:
        return path, used
    for file in used:
        shutil.copyfile(file, folder / file.name)
    sqlite.apply_journal(folder / path.name)
    return folder / path.name, used
