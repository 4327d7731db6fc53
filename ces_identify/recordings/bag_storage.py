"""A bag on disk: its topics, message definitions, data files and raw messages, for every storage format.

rosbags opens the bag and reads metadata and definitions; the messages come in blocks, in recorded order.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import zstandard
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.interfaces.typing import Typesdict
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ces_identify.recordings import mcap_records, sqlite_records
from ces_identify.recordings.bulk_decode import Block
from ces_observer.errors import RecordingError

IDL_SEPARATOR = "=" * 80 + "\n"


@dataclass(frozen=True)
class Topic:
    """One topic of a bag and the number of its messages."""

    name: str
    type: str
    count: int


class Bag:
    """An open bag; made by `open_bag`."""

    def __init__(self, path: Path, reader: Reader) -> None:
        self.path = path
        self.connections = tuple(reader.connections)
        self._storages: list[Any] = getattr(reader.storage, "storages", [reader.storage])
        self._packed = reader.compression_mode == "message"

    @property
    def topics(self) -> tuple[Topic, ...]:
        """All topics, by name."""
        counts: dict[tuple[str, str], int] = {}
        for connection in self.connections:
            key = (connection.topic, connection.msgtype)
            counts[key] = counts.get(key, 0) + connection.msgcount
        return tuple(Topic(name, kind, count) for (name, kind), count in sorted(counts.items()))

    def sha256(self) -> str:
        """Return the hash of the stored bytes of all data files in order."""
        digest = hashlib.sha256()
        for storage in self._storages:
            with self._find_stored_file(storage.path).open("rb") as file:
                while part := file.read(1 << 20):
                    digest.update(part)
        return digest.hexdigest()

    def blocks(self, topics: Collection[str]) -> Iterator[tuple[str, Block]]:
        """Yield the messages of these topics, block by block."""
        for storage in self._storages:
            numbers = {name: [c.id for c in storage.connections if c.topic == name] for name in topics}
            mcap = storage.path.suffix == ".mcap"
            ids = [i for some in numbers.values() for i in some]
            for block in mcap_records.blocks(storage.path) if mcap else sqlite_records.blocks(storage.path, ids):
                for name, mine in numbers.items():
                    part = block.select_topics(mine)
                    if len(part):
                        yield name, self._unpack(part)

    def typestore(self, topic: Topic) -> Typestore:
        """Return the types of a topic: the bag's own definitions, or those of ROS 2 Jazzy if it has none."""
        mine = [c for c in self.connections if c.topic == topic.name]
        self._require_cdr(mine)
        defined = [c.msgdef for c in mine if c.msgdef.format != MessageDefinitionFormat.NONE]
        if defined:
            return self._own_types(topic, defined[0])
        store = get_typestore(Stores.ROS2_JAZZY)
        if topic.type not in store.fielddefs:
            raise RecordingError(
                f"{self.path}: topic {topic.name} is {topic.type}, neither of ROS 2 Jazzy nor defined in the bag;"
                " record it with MCAP storage, which keeps the definition"
            )
        return store

    def _own_types(self, topic: Topic, definition: MessageDefinition) -> Typestore:
        try:
            store = get_typestore(Stores.EMPTY)
            store.register(_types(definition, topic.type))
            return store
        except TypesysError as error:
            raise RecordingError(f"{self.path}: the definition of {topic.type} in the bag: {error}") from None

    def _require_cdr(self, connections: list[Connection]) -> None:
        for connection in connections:
            encoding = cast(ConnectionExtRosbag2, connection.ext).serialization_format
            if encoding != "cdr":
                raise RecordingError(f"{self.path}: topic {connection.topic} is encoded as '{encoding}'; expected cdr")

    def _find_stored_file(self, file: Path) -> Path:
        """Return the file in the bag; for a file compressed as a whole, `file` is a temporary copy."""
        packed = self.path / f"{file.name}.zstd"
        return packed if self.path.is_dir() and file.parent != self.path and packed.exists() else file

    def _unpack(self, block: Block) -> Block:
        """Decompress the messages of a bag with message compression."""
        if not self._packed:
            return block
        unpack = zstandard.ZstdDecompressor().decompress
        try:
            payloads = [unpack(block.payload(i)) for i in range(len(block))]
        except zstandard.ZstdError as error:
            raise RecordingError(f"{self.path}: a compressed message is damaged: {error}; copy it again") from None
        return Block.join(payloads, block.topics, block.log_ns)


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a rosbag2 folder, or an `.mcap` or `.db3` file; raises RecordingError if it is damaged or truncated."""
    if not path.exists():
        raise RecordingError(f"{path}: no such file or folder; expected a rosbag2 folder or an .mcap file")
    if path.is_dir() and not (path / "metadata.yaml").exists():
        raise RecordingError(f"{path}: the folder has no metadata.yaml; expected a bag (ros2 bag reindex writes one)")
    try:
        reader = Reader(path)
        reader.open()
    except Exception as error:  # a damaged file makes rosbags raise errors of any kind
        raise _open_error(path, error) from None
    try:
        yield Bag(path, reader)
    finally:
        reader.close()


def _open_error(path: Path, error: Exception) -> RecordingError:
    for file in path.glob("*.mcap") if path.is_dir() else [path]:
        if file.suffix == ".mcap":
            mcap_records.require_complete(file)
    reason = str(error).strip().splitlines()[0].rstrip(".") if str(error).strip() else type(error).__name__
    return RecordingError(f"{path}: cannot be opened as a bag: {reason}")


def _types(definition: MessageDefinition, name: str) -> Typesdict:
    if definition.format == MessageDefinitionFormat.MSG:
        return get_types_from_msg(definition.data, name)
    parts = definition.data.split(IDL_SEPARATOR)
    texts = [part.partition("\n")[2] for part in parts if part.startswith("IDL: ")] or [definition.data]
    types: Typesdict = {}
    for text in texts:
        types.update(get_types_from_idl(text))
    return types
