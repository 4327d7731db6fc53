"""ROS 1 bags (`.bag`): their topics, and their messages as blocks in recorded order, converted to CDR."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ces_data.bags.decode import Block, StoredTopic
from ces_data.config_file import first_line
from ces_observer.errors import RecordingError

SUFFIX = ".bag"
BATCH = 5_000  # messages per block
SEPARATOR = "=" * 80 + "\n"
HEADER_SECTION, SEQUENCE = "MSG: std_msgs/Header\n", "uint32 seq\n"
TIMES = "".join(f"{SEPARATOR}MSG: builtin_interfaces/{t}\nint32 sec\nuint32 nanosec\n" for t in ("Time", "Duration"))


def list_topics(path: Path) -> tuple[StoredTopic, ...]:
    """Return the topics of a bag, with definitions as ROS 2 has them; raises RecordingError if it is damaged."""
    with _reading(path) as reader:
        return tuple(
            StoredTopic(c.id, c.topic, c.msgtype, _as_ros2(c.msgdef.data), "cdr", c.msgcount)
            for c in reader.connections
        )


def blocks(path: Path, topics: Sequence[int]) -> Iterator[Block]:
    """Yield the messages of these topics; raises RecordingError if the bag is damaged."""
    with _reading(path) as reader:
        connections = [c for c in reader.connections if c.id in set(topics)]
        stores = {connection.id: get_typestore(Stores.EMPTY) for connection in connections}
        for c in connections:
            stores[c.id].register(get_types_from_msg(_as_ros2(c.msgdef.data).data, c.msgtype))
        messages = reader.messages(connections=connections)
        while batch := list(islice(messages, BATCH)):
            payloads = [bytes(stores[c.id].ros1_to_cdr(raw, c.msgtype)) for c, _, raw in batch]
            yield Block.join(payloads, [c.id for c, _, _ in batch], [stamp_ns for _, stamp_ns, _ in batch])


def _as_ros2(definition: str) -> MessageDefinition:
    """Return a definition without the sequence number that ROS 2's header does not have, and with the type of times."""
    parts = definition.split(SEPARATOR)
    kept = [part.replace(SEQUENCE, "") if part.startswith(HEADER_SECTION) else part for part in parts]
    return MessageDefinition(MessageDefinitionFormat.MSG, SEPARATOR.join(kept).rstrip("\n") + "\n" + TIMES)


@contextmanager
def _reading(path: Path) -> Iterator[Reader]:
    try:
        with Reader(path) as reader:
            yield reader
    except (RecordingError, GeneratorExit):
        raise
    except Exception as error:  # a damaged file makes rosbags raise errors of any kind
        reason = f"{first_line(error).rstrip('.')}; 'rosbag reindex' may repair it"
        raise RecordingError(f"{path}: not a ROS 1 bag, or damaged: {reason}") from error
