"""ROS 1 bags (`.bag`): their topics, and their messages as blocks in recorded order, converted to CDR."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader

from ces_data.bags.decode import Block, StoredTopic
from ces_data.bags.foreign import as_ros2, make_converter
from ces_data.config_file import first_line
from ces_observer.errors import RecordingError

SUFFIX = ".bag"
BATCH = 5_000  # messages per block


def list_topics(path: Path) -> tuple[StoredTopic, ...]:
    """Return the topics of a bag, with definitions as ROS 2 has them; raises RecordingError if it is damaged."""
    with _reading(path) as reader:
        return _list_stored(reader.connections)


def blocks(path: Path, topics: Sequence[int]) -> Iterator[Block]:
    """Yield the messages of these topics; raises RecordingError if the bag is damaged."""
    with _reading(path) as reader:
        connections = [c for c in reader.connections if c.id in set(topics)]
        convert = {topic.id: make_converter(topic) for topic in _list_stored(connections)}
        messages = reader.messages(connections=connections)
        while batch := list(islice(messages, BATCH)):
            payloads = [convert[c.id](raw) for c, _, raw in batch]
            yield Block.join(payloads, [c.id for c, _, _ in batch], [stamp_ns for _, stamp_ns, _ in batch])


def _list_stored(connections: Iterable[Connection]) -> tuple[StoredTopic, ...]:
    return tuple(StoredTopic(c.id, c.topic, c.msgtype, as_ros2(c.msgdef.data), "cdr", c.msgcount) for c in connections)


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
