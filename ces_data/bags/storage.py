"""A bag on disk: its topics, message definitions, data files and raw messages, for every storage format.

The messages come in blocks, in recorded order. `ros2 bag record` writes metadata.yaml, and the summary and footer of an
MCAP file, only when it ends in order; of a recorder that was killed, the files themselves say which topics they hold.
They are read where they are, or from temporary copies; nothing in the bag changes.
"""

from __future__ import annotations

import hashlib
import re
import shutil
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import numpy as np
import yaml
import zstandard
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.interfaces.typing import FieldDesc, Typesdict
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ces_data.bags import foreign, mcap, sqlite
from ces_data.bags.decode import Block, StoredTopic
from ces_data.bags.foreign import Convert
from ces_data.config_file import first_line
from ces_data.log_formats import explain_import, is_foreign, suggest_path
from ces_observer.errors import RecordingError

IDL_SEPARATOR = "=" * 80 + "\n"
PREPROCESSOR = re.compile(r"^[ \t]*#.*$", re.MULTILINE)  # lines of IDL, whose files are in the definition, too
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # a message begins with 0
METADATA = "metadata.yaml"
SUFFIXES = (".mcap", ".db3")
PACKED = ".zstd"
WRITTEN_BY = "written_by"  # note of every bag of `writer`, whose log times are the samples' stamps
SPEED, MEASURED, ALONE = "speed", "measured", "alone"  # note of a bag with the velocity beside the position
WRITER_NOTES = {WRITTEN_BY, "ces_rig", "imported_from", "model_sha256"}  # the other ones are of earlier versions


@dataclass(frozen=True)
class Topic:
    """One topic of a bag and the number of its messages."""

    name: str
    type: str
    count: int


@dataclass(frozen=True)
class DataFile:
    """A data file at `path`, made of the bag's files `stored`; an `interrupted` one ends with a whole message."""

    path: Path
    stored: tuple[Path, ...]
    topics: tuple[StoredTopic, ...]
    interrupted: bool = False
    convert: Mapping[int, Convert] = field(default_factory=dict)  # of topics that are not of ROS 2

    @classmethod
    def of_mcap(cls, path: Path, stored: Path, interrupted: bool = False) -> DataFile:
        """Return an MCAP file by itself, whose messages of ROS 1 and in JSON are taken as those of ROS 2."""
        topics, first = mcap.list_topics(path), dict[int, bytes]()
        waiting = {topic.id for topic in topics if topic.encoding == "json" and topic.count}
        for block in mcap.blocks(path, interrupted=interrupted) if waiting else ():
            for number in waiting & set(block.topics.tolist()):
                first[number] = block.payload(int(np.argmax(block.topics == number)))
            waiting -= first.keys()
            if not waiting:
                break
        adopted = {topic.id: foreign.adopt(topic, first.get(topic.id, b"")) for topic in topics}
        convert = {number: convert for number, (_, convert) in adopted.items() if convert}
        return cls(path, (stored,), tuple(topic for topic, _ in adopted.values()), interrupted, convert)

    def blocks(self, topics: Sequence[int]) -> Iterator[Block]:
        """Yield the messages of these topics, and in an MCAP file of the others, too."""
        if self.path.suffix == ".mcap":
            return map(self._as_cdr, mcap.blocks(self.path, interrupted=self.interrupted))
        if self.path.suffix == foreign.SUFFIX:
            return foreign.blocks(self.path, topics)
        return sqlite.blocks(self.path, topics)

    def _as_cdr(self, block: Block) -> Block:
        if not self.convert:
            return block
        try:
            numbers = block.topics.tolist()
            same: Convert = bytes
            payloads = [self.convert.get(n, same)(block.payload(i)) for i, n in enumerate(numbers)]
        except Exception as error:  # of a library, for a damaged message
            raise RecordingError(f"{self.path}: a message cannot be decoded: {first_line(error)}") from None
        return Block.join(payloads, block.topics, block.log_ns)


@dataclass(frozen=True)
class Bag:
    """An open bag: topics of all files, a `warning` for the user, whether log times are the samples' stamps.

    `speed` says what `ces import` found beside the positions: MEASURED, ALONE (they are its integral), or nothing.
    """

    path: Path
    stored_topics: tuple[StoredTopic, ...]
    files: tuple[DataFile, ...]
    warning: str = ""
    exact_log_times: bool = False
    speed: str = ""

    @property
    def topics(self) -> tuple[Topic, ...]:
        """All topics, by name."""
        counts: Counter[tuple[str, str]] = Counter()
        for topic in self.stored_topics:
            counts[topic.name, topic.type] += topic.count
        return tuple(Topic(name, kind, count) for (name, kind), count in sorted(counts.items()))

    def sha256(self) -> str:
        """Return the hash of the stored bytes of all data files in order."""
        digest = hashlib.sha256()
        for path in (path for data in self.files for path in data.stored):
            with path.open("rb") as file:
                while part := file.read(1 << 20):
                    digest.update(part)
        return digest.hexdigest()

    def blocks(self, topics: Collection[str]) -> Iterator[tuple[str, Block]]:
        """Yield the messages of these topics, block by block."""
        for file in self.files:
            numbers = {name: [t.id for t in file.topics if t.name == name] for name in topics}
            for block in file.blocks([i for some in numbers.values() for i in some]):
                for name, mine in numbers.items():
                    part = block.select_topics(mine)
                    if len(part):
                        yield name, self._unpack(part)

    def typestore(self, topic: Topic) -> Typestore:
        """Return the types of a topic: the bag's own definitions, or those of ROS 2 Jazzy if it has none."""
        mine = [t for t in self.stored_topics if t.name == topic.name]
        if others := [t.encoding for t in mine if t.encoding != "cdr"]:
            remedy = "expected cdr, ros1 or json; write its numbers as a CSV table, and import that"
            raise RecordingError(f"{self.path}: topic {topic.name} is encoded as '{others[0]}'; {remedy}")
        definition = next((t.definition for t in mine if t.definition.format != MessageDefinitionFormat.NONE), None)
        store = get_typestore(Stores.ROS2_JAZZY if definition is None else Stores.EMPTY)
        if definition is not None:
            where = f"{self.path}: the definition of {topic.type} in the bag"
            try:
                store.register(_complete_types(_parse_types(definition, topic.type), topic.type, where))
            except TypesysError as error:
                raise RecordingError(f"{where}: {first_line(error)}") from None
        elif topic.type not in store.fielddefs:
            unknown = f"topic {topic.name} is {topic.type}, neither of ROS 2 Jazzy nor defined in the bag"
            raise RecordingError(f"{self.path}: {unknown}; record it with MCAP storage, which keeps the definition")
        return store

    def _unpack(self, block: Block) -> Block:
        """Decompress the messages of a bag with message compression."""
        if not block.payload(0).startswith(ZSTD_MAGIC):
            return block
        unpack = zstandard.ZstdDecompressor().decompress
        try:
            payloads = [unpack(block.payload(i)) for i in range(len(block))]
        except zstandard.ZstdError as error:
            raise RecordingError(f"{self.path}: a compressed message is damaged: {error}; copy it again") from None
        return Block.join(payloads, block.topics, block.log_ns)


def _parse_types(definition: MessageDefinition, name: str) -> Typesdict:
    if definition.format == MessageDefinitionFormat.MSG:
        return get_types_from_msg(definition.data, name)
    parts = definition.data.split(IDL_SEPARATOR)
    texts = [part.partition("\n")[2] for part in parts if part.startswith("IDL: ")] or [definition.data]
    types: Typesdict = {}
    for text in texts:
        types.update(get_types_from_idl(PREPROCESSOR.sub("", text)))
    return types


def _complete_types(types: Typesdict, name: str, where: str) -> Typesdict:
    """Return the types with those of ROS 2 Jazzy that they use and do not define; raises RecordingError for others."""
    known, waiting = get_typestore(Stores.ROS2_JAZZY).fielddefs, [name]
    seen = set(waiting)
    while waiting:
        kind = waiting.pop()
        if kind not in types and kind not in known:
            remedy = "record it with all its types, or leave the topic out (mcap filter)"
            raise RecordingError(f"{where} uses {kind}, which neither the bag nor ROS 2 Jazzy defines; {remedy}")
        types.setdefault(kind, known[kind] if kind not in types else types[kind])
        used = {str(one) for _, of in types[kind][1] for one in _named_types(of)}
        waiting += used - seen
        seen |= used
    return types


def _named_types(description: FieldDesc) -> Iterator[str]:
    """Yield the names of the messages in a field's type."""
    kind, content = description
    if kind == Nodetype.NAME:
        yield str(content)
    elif kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        yield from _named_types(cast(FieldDesc, content[0]))


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a rosbag2 folder, an `.mcap` or `.db3` file, or a ROS 1 `.bag` file.

    A folder without metadata.yaml is that of a recorder that was killed. With metadata.yaml (`ros2 bag reindex` writes
    one), an unfinished file is read if it has all messages. Raises RecordingError if a bag is damaged or truncated.
    """
    if not path.exists():
        raise RecordingError(f"{path}: no such file or folder{suggest_path(path) or '; expected a bag or a log'}")
    if is_foreign(path):
        raise RecordingError(f"{path}: {explain_import(path)}")
    with ExitStack() as opened:
        yield _open(path, opened)


def _open(path: Path, opened: ExitStack) -> Bag:
    if path.is_dir() and not (path / METADATA).exists():
        return opened.enter_context(_open_interrupted_bag(path))
    if path.suffix == foreign.SUFFIX and path.is_file():
        topics = foreign.list_topics(path)
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
                whole = DataFile.of_mcap(file, file)
                if path == file and any(topic.encoding != "cdr" for topic in mcap.list_topics(file)):
                    return Bag(path, whole.topics, (whole,))
        if path.is_file() and path.suffix not in (".mcap", ".db3"):
            what = "neither a bag (a folder, or .mcap) nor a log that is read here, such as .csv, .mat or .parquet"
            raise RecordingError(f"{path}: is {what}; save it as one of these") from None
        raise RecordingError(f"{path}: cannot be opened as a bag: {first_line(error).rstrip('.')}") from None
    opened.callback(reader.close)
    storages: list[Any] = getattr(reader.storage, "storages", [reader.storage])
    files = []
    for storage in storages:
        packed = path / f"{storage.path.name}{PACKED}"  # of it, the storage's path is a temporary copy
        copied = path.is_dir() and storage.path.parent != path and packed.exists()
        stored = packed if copied else storage.path
        files.append(DataFile(storage.path, (stored,), _stored_topics(storage.connections)))
    notes = _read_metadata(path).get("custom_data") if path.is_dir() else None
    notes = notes if isinstance(notes, dict) else {}
    exact, speed = not WRITER_NOTES.isdisjoint(notes), str(notes.get(SPEED, ""))
    return Bag(path, _stored_topics(reader.connections), tuple(files), exact_log_times=exact, speed=speed)


def _read_metadata(path: Path) -> Any:
    return yaml.safe_load((path / METADATA).read_text())["rosbag2_bagfile_information"]


def _open_reindexed(path: Path, opened: ExitStack) -> Bag | None:
    """Return the bag with an unfinished file if it has as many messages as its metadata say, else None."""
    try:
        stated = _read_metadata(path)["message_count"]
        bag = opened.enter_context(_open_interrupted_bag(path))
    except (RecordingError, OSError, ValueError, yaml.YAMLError, KeyError, TypeError):
        return None
    return bag if sum(topic.count for topic in bag.topics) == stated else None


def _stored_topics(connections: Iterable[Connection]) -> tuple[StoredTopic, ...]:
    topics = []
    for c in connections:
        encoding, profiles = cast(ConnectionExtRosbag2, c.ext)
        topics.append(StoredTopic(c.id, c.topic, c.msgtype, c.msgdef, encoding, c.msgcount, len(profiles)))
    return tuple(topics)


def list_data_files(path: Path) -> list[Path]:
    """Return the data files of a bag's folder in recorded order; of a file and its compressed copy, the file."""
    files = list(path.iterdir())
    by_name = {file.name.removesuffix(PACKED): file for file in files if file.name.endswith(PACKED)}
    by_name |= {file.name: file for file in files if file.stat().st_size}

    def by_number(name: str) -> list[tuple[int, str]]:  # run_10 after run_9
        return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"(\d+)", name)]

    return [by_name[name] for name in sorted(by_name, key=by_number) if name.endswith(SUFFIXES)]


@contextmanager
def _open_interrupted_bag(path: Path) -> Iterator[Bag]:
    """Open a bag's folder without metadata; raises RecordingError if a file is damaged or any but the last is cut."""
    stored = list_data_files(path)
    if not stored and any(path.glob("*.mcap")):
        raise RecordingError(
            f"{path}: the recorder was killed before its first chunk was stored; nothing can be recovered: record again"
            " (--storage-preset-profile fastwrite stores each message at once)"
        )
    if not stored:
        raise RecordingError(f"{path}: the folder has no {METADATA} and no .mcap or .db3 file; expected a bag")
    with TemporaryDirectory() as folder:
        files = tuple(_open_file(file, Path(folder), last=file == stored[-1]) for file in stored)
        topics = tuple(topic for file in files for topic in file.topics)
        count = sum(topic.count for topic in topics)
        text = f"the recorder did not end in order (killed?); the {count} messages that it had stored are read"
        yield Bag(path, topics, files, f"{path}: {text}")


def _open_file(file: Path, folder: Path, *, last: bool) -> DataFile:
    path = file
    if file.suffix == PACKED:
        path = folder / file.name.removesuffix(PACKED)
        try:
            with file.open("rb") as packed, path.open("wb") as unpacked:
                zstandard.ZstdDecompressor().copy_stream(packed, unpacked)
        except zstandard.ZstdError as error:
            raise RecordingError(f"{file}: cannot be decompressed: {error}; copy it again") from None
    if path.suffix == ".mcap":
        (mcap.require_mcap_file if last else mcap.require_complete)(path)
        return DataFile.of_mcap(path, file, interrupted=True)
    journals = [path.with_name(path.name + ending) for ending in ("-wal", "-journal")]
    used = (path, *(journal for journal in journals if journal.exists() and journal.stat().st_size))
    if len(used) > 1:  # the journal is applied to a copy
        for part in used:
            shutil.copyfile(part, folder / part.name)
        path = folder / path.name
        sqlite.apply_journal(path)
    return DataFile(path, used, sqlite.list_topics(path))
