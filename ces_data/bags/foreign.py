"""What is not of ROS 2 as if it were: ROS 1 bags (`.bag`), and messages of ROS 1 and JSON inside MCAP files.

Definitions become those of ROS 2, messages CDR; those of a bag come as blocks in recorded order.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ces_data.bags.decode import Block, StoredTopic
from ces_data.config_file import first_line
from ces_observer.errors import RecordingError

SEPARATOR = "=" * 80 + "\n"
HEADER_SECTION, SEQUENCE = "MSG: std_msgs/Header\n", "uint32 seq\n"
TIMES = "".join(f"{SEPARATOR}MSG: builtin_interfaces/{t}\nint32 sec\nuint32 nanosec\n" for t in ("Time", "Duration"))
Convert = Callable[[bytes], bytes]


def adopt(topic: StoredTopic, first: bytes) -> tuple[StoredTopic, Convert | None]:
    """Return a topic as one of ROS 2 and what converts its messages; None for those of ROS 2, and of other kinds.

    `first` is its first message, whose fields are those of all in JSON.
    """
    try:
        if topic.encoding == "ros1":
            kind = topic.type if "/msg/" in topic.type else topic.type.replace("/", "/msg/")
            adopted = replace(topic, type=kind, encoding="cdr", definition=as_ros2(topic.definition.data))
            return adopted, make_converter(adopted)
        if topic.encoding == "json" and isinstance(content := json.loads(first), Mapping):
            return _adopt_json(topic, content)
    except (TypesysError, ValueError):
        pass  # it stays what it is, and is refused if it is needed
    return topic, None


def make_converter(topic: StoredTopic) -> Convert:
    """Return what converts a topic's messages of ROS 1 to CDR; the definition is as ROS 2 has it."""
    store = _store(topic)
    return lambda raw: bytes(store.ros1_to_cdr(raw, topic.type))


def as_ros2(definition: str) -> MessageDefinition:
    """Return a definition without the sequence number that ROS 2's header does not have, and with the type of times."""
    parts = definition.split(SEPARATOR)
    kept = [part.replace(SEQUENCE, "") if part.startswith(HEADER_SECTION) else part for part in parts]
    return MessageDefinition(MessageDefinitionFormat.MSG, SEPARATOR.join(kept).rstrip("\n") + "\n" + TIMES)


def _store(topic: StoredTopic) -> Typestore:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(topic.definition.data, topic.type))
    return store


def _adopt_json(topic: StoredTopic, first: Mapping[str, Any]) -> tuple[StoredTopic, Convert | None]:
    kind = "json/msg/" + re.sub(r"\W|^(?=\d)", "_", topic.type or topic.name.strip("/") or "Message").strip("_")
    sections = list(_define(kind, first))
    if not any("float64" in section for section in sections):
        return topic, None
    own, *nested = sections
    text = own + "".join(f"{SEPARATOR}{section}" for section in nested)
    adopted = replace(topic, type=kind, encoding="cdr", definition=MessageDefinition(MessageDefinitionFormat.MSG, text))
    store = _store(adopted)
    return adopted, lambda raw: bytes(store.serialize_cdr(_fill(store, kind, first, json.loads(raw)), kind))


def _define(kind: str, content: Mapping[str, Any], title: str = "") -> Iterator[str]:
    """Yield the definition of a message with the numbers and names in JSON, and those of the messages inside it."""
    lines, nested = [title], list[str]()
    for key, value in content.items():
        if of := _type_of(value):
            lines.append(f"{of} {_name(key)}\n")
        elif isinstance(value, Mapping):
            inner = f"{kind}_{_name(key)}"
            lines.append(f"{inner.replace('/msg/', '/')} {_name(key)}\n")
            nested += _define(inner, value, f"MSG: {inner.replace('/msg/', '/')}\n")
    yield "".join(lines)
    yield from nested


def _fill(store: Typestore, kind: str, first: Mapping[str, Any], content: Any) -> Any:
    """Return the message of JSON; a number that is none, or missing, is NaN."""
    fields: dict[str, Any] = {}
    for key, like in first.items():
        value, of = content.get(key) if isinstance(content, Mapping) else None, _type_of(like)
        if of == "string[]":
            fields[_name(key)] = [str(text) for text in value] if isinstance(value, list) else []
        elif of == "float64[]":
            fields[_name(key)] = np.array(list(map(_number, value if isinstance(value, list) else [])), np.float64)
        elif of:
            fields[_name(key)] = _number(value)
        elif isinstance(like, Mapping):
            fields[_name(key)] = _fill(store, f"{kind}_{_name(key)}", like, value)
    return store.types[kind](**fields)


def _type_of(value: Any) -> str:
    """Return the type of a field of ROS 2 for numbers and names in JSON, '' for anything else."""
    if isinstance(value, int | float):
        return "float64"
    if isinstance(value, list) and value:
        for kind, of in (((int, float), "float64[]"), (str, "string[]")):
            if all(isinstance(item, kind) for item in value):
                return of
    return ""


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else np.nan


def _name(key: str) -> str:
    return re.sub(r"\W|^(?=[\d_])", "_", key).strip("_") or "field"


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
