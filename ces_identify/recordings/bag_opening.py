"""Opens bags: finished ones with the metadata and definitions that rosbags reads, and those of a killed recorder."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, cast

import yaml
from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.rosbag2 import Reader

from ces_identify.recordings import mcap_records, mcap_topics, rosbag1_records
from ces_identify.recordings.bag_storage import Bag, DataFile
from ces_identify.recordings.foreign_files import explain_import, is_foreign
from ces_identify.recordings.interrupted_bag import list_data_files, open_interrupted_bag
from ces_identify.recordings.stored_topic import StoredTopic
from ces_observer.errors import RecordingError

METADATA = "metadata.yaml"
WRITTEN_BY = "written_by"  # note of every bag of `bag_writer`, whose log times are the samples' stamps
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
    if path.suffix == rosbag1_records.SUFFIX and path.is_file():
        topics = rosbag1_records.list_topics(path)
        return Bag(path, topics, (DataFile(path, (path,), topics),))
    try:
        reader = Reader(path)
        reader.open()
    except Exception as error:  # a damaged file makes rosbags raise errors of any kind
        if path.is_dir() and (bag := _open_reindexed(path, opened)):
            return bag
        raise _open_error(path, error) from None
    opened.callback(reader.close)
    files = tuple(_data_files(path, reader))
    return Bag(path, _stored_topics(reader.connections), files, exact_log_times=_has_exact_log_times(path))


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


def _open_reindexed(path: Path, opened: ExitStack) -> Bag | None:
    """Return the bag with an unfinished file if it has as many messages as its metadata say, else None."""
    try:
        stated = yaml.safe_load((path / METADATA).read_text())["rosbag2_bagfile_information"]["message_count"]
        bag = opened.enter_context(open_interrupted_bag(path))
    except (RecordingError, OSError, ValueError, yaml.YAMLError, KeyError, TypeError):
        return None
    return bag if sum(topic.count for topic in bag.topics) == stated else None


def _has_exact_log_times(path: Path) -> bool:
    """Return whether the notes in a bag's metadata say that `bag_writer` wrote it."""
    if not path.is_dir():
        return False
    notes = yaml.safe_load((path / METADATA).read_text())["rosbag2_bagfile_information"].get("custom_data")
    return isinstance(notes, dict) and not WRITER_NOTES.isdisjoint(notes)


def _stored_topics(connections: Iterable[Connection]) -> tuple[StoredTopic, ...]:
    def encoding(connection: Connection) -> str:
        return cast(ConnectionExtRosbag2, connection.ext).serialization_format

    return tuple(StoredTopic(c.id, c.topic, c.msgtype, c.msgdef, encoding(c), c.msgcount) for c in connections)


def _data_files(path: Path, reader: Reader) -> Iterator[DataFile]:
    storages: list[Any] = getattr(reader.storage, "storages", [reader.storage])
    for storage in storages:
        yield DataFile(storage.path, (_find_stored_file(path, storage.path),), _stored_topics(storage.connections))


def _find_stored_file(path: Path, file: Path) -> Path:
    """Return the file in the bag; for a file compressed as a whole, `file` is a temporary copy."""
    packed = path / f"{file.name}.zstd"
    return packed if path.is_dir() and file.parent != path and packed.exists() else file


def _require_ros2(file: Path) -> None:
    """Raise RecordingError if topics of a complete MCAP file are encoded in another way than ROS 2 does."""
    topics = mcap_topics.list_topics(file)
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


def _open_error(path: Path, error: Exception) -> RecordingError:
    for file in path.glob("*.mcap") if path.is_dir() else [path]:
        if file.suffix == ".mcap":
            mcap_records.require_complete(file)
            _require_ros2(file)
    reason = str(error).strip().splitlines()[0].rstrip(".") if str(error).strip() else type(error).__name__
    return RecordingError(f"{path}: cannot be opened as a bag: {reason}")
