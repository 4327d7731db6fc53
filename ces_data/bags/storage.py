"""A bag on disk: its topics, message definitions, data files and raw messages, for every storage format.

The messages come in blocks, in recorded order. `opening` opens a bag.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import zstandard
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ces_data.bags import mcap, rosbag1, sqlite
from ces_data.bags.decode import Block, StoredTopic
from ces_observer.errors import RecordingError

IDL_SEPARATOR = "=" * 80 + "\n"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # a message begins with 0


@dataclass(frozen=True)
class Topic:
    """One topic of a bag and the number of its messages."""

    name: str
    type: str
    count: int


@dataclass(frozen=True)
class DataFile:
    """A data file: `path` is read, `stored` are the files of the bag that it is or was made of.

    `interrupted`: the file's recorder was killed, and the file ends with the last whole message.
    """

    path: Path
    stored: tuple[Path, ...]
    topics: tuple[StoredTopic, ...]
    interrupted: bool = False

    def blocks(self, topics: Sequence[int]) -> Iterator[Block]:
        """Yield the messages of these topics, and in an MCAP file of the others, too."""
        if self.path.suffix == ".mcap":
            return mcap.blocks(self.path, interrupted=self.interrupted)
        if self.path.suffix == rosbag1.SUFFIX:
            return rosbag1.blocks(self.path, topics)
        return sqlite.blocks(self.path, topics)


@dataclass(frozen=True)
class Bag:
    """An open bag; `stored_topics` are those of all its files, `warning` is what the user should know about it.

    `exact_log_times`: the log time of a message is its sample's stamp, as in the bags that `bag_writer` writes.
    """

    path: Path
    stored_topics: tuple[StoredTopic, ...]
    files: tuple[DataFile, ...]
    warning: str = ""
    exact_log_times: bool = False

    @property
    def topics(self) -> tuple[Topic, ...]:
        """All topics, by name."""
        counts: dict[tuple[str, str], int] = {}
        for topic in self.stored_topics:
            key = (topic.name, topic.type)
            counts[key] = counts.get(key, 0) + topic.count
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
        for stored in mine:
            if stored.encoding != "cdr":
                raise RecordingError(
                    f"{self.path}: topic {stored.name} is encoded as '{stored.encoding}'; expected cdr"
                )
        definition = next((t.definition for t in mine if t.definition.format != MessageDefinitionFormat.NONE), None)
        store = get_typestore(Stores.ROS2_JAZZY if definition is None else Stores.EMPTY)
        if definition is not None:
            try:
                store.register(_parse_types(definition, topic.type))
            except TypesysError as error:
                raise RecordingError(f"{self.path}: the definition of {topic.type} in the bag: {error}") from None
        elif topic.type not in store.fielddefs:
            raise RecordingError(
                f"{self.path}: topic {topic.name} is {topic.type}, neither of ROS 2 Jazzy nor defined in the bag;"
                " record it with MCAP storage, which keeps the definition"
            )
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
        types.update(get_types_from_idl(text))
    return types
