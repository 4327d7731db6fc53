"""Every number in every topic of a bag, for programs that do not know yet which of them are signals.

A bag goes in; the series of each numeric field comes out, with array elements by joint name where the message names its
joints. Topics that hold no signal of a damper (images, point clouds, logs, transforms) are passed over.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from ces_identify.recordings.bag_message import JOINT_NAMES
from ces_identify.recordings.bag_opening import open_bag
from ces_identify.recordings.bag_reader import DAMAGED, HEADER, STAMP, make_decoder
from ces_identify.recordings.bag_storage import Bag, Topic
from ces_identify.recordings.bulk_decode import Block, Floats, Index
from ces_identify.recordings.recording import Stamps, Values
from ces_observer.errors import CesError, RecordingError, SignalsError
from ces_observer.signals import FieldPath

MAX_FIELDS = 64  # of one topic
MAX_ELEMENTS = 32  # of one array
MAX_SAMPLES = 200_000  # of one topic: 200 s at 1 kHz
MAX_MESSAGE = 20_000  # bytes; a larger message is an image or the like
PASSED_OVER = (
    "rcl_interfaces/", "tf2_msgs/", "diagnostic_msgs/", "rosgraph_msgs/", "visualization_msgs/", "nav_msgs/msg/Path",
    "nav_msgs/msg/OccupancyGrid", "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/PointCloud", "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/CameraInfo",
)  # fmt: skip
NUMBERS = {"float32", "float64", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}


@dataclass(frozen=True)
class FieldSeries:
    """The numbers at one field of a topic: `stamps_ns` int64 and `values` float64, both (n,), as `read_recording`."""

    topic: str
    type: str
    field: str
    stamps_ns: Stamps
    values: Values


@dataclass(frozen=True)
class BagFields:
    """All series of a bag, the number of messages of each topic, and why topics were not read."""

    series: tuple[FieldSeries, ...]
    topics: tuple[Topic, ...]
    skipped: Mapping[str, str]


def read_fields(path: Path) -> BagFields:
    """Read the numbers of every topic, up to 200,000 messages of each; raises RecordingError if the bag is damaged."""
    with open_bag(path) as bag:
        skipped = {topic.name: why for topic in bag.topics if (why := _why_skipped(topic))}
        readers: dict[str, _FieldsReader] = {}
        for name, block in bag.blocks({topic.name for topic in bag.topics} - set(skipped)):
            if name not in readers and name not in skipped:
                _add_reader(bag, name, block, readers, skipped)
            if name in readers:
                readers[name].add(block)
            if len(readers) + len(skipped) == len(bag.topics) and all(reader.full for reader in readers.values()):
                break
        series = tuple(one for reader in readers.values() for one in reader.series())
        return BagFields(series, bag.topics, skipped)


def read_series(path: Path, fields: Sequence[tuple[str, str]]) -> list[FieldSeries]:
    """Read the numbers at these topics and fields, all messages; raises RecordingError or SignalsError."""
    with open_bag(path) as bag:
        readers: dict[str, _FieldsReader] = {}
        for name in {name for name, _ in fields}:
            topic = next((topic for topic in bag.topics if topic.name.lstrip("/") == name.lstrip("/")), None)
            if topic is None:
                known = ", ".join(f"{topic.name} ({topic.type})" for topic in bag.topics)
                raise RecordingError(f"{path}: no topic '{name}'; the bag has {known}")
            paths = tuple(FieldPath.parse(text) for at, text in fields if at == name)
            readers[topic.name] = _FieldsReader(bag, topic, paths, bag.typestore(topic), limit=None)
        for name, block in bag.blocks(readers):
            readers[name].add(block)
        found = {(s.topic.lstrip("/"), s.field): s for reader in readers.values() for s in reader.series()}
        for name, text in fields:
            if (name.lstrip("/"), text) not in found:
                reader = next(r for r in readers.values() if r.topic.name.lstrip("/") == name.lstrip("/"))
                raise SignalsError(f"{path}: topic {name}: {reader.reason(text)}")
        return [found[name.lstrip("/"), text] for name, text in fields]


def _why_skipped(topic: Topic) -> str:
    if not topic.count:
        return "no messages"
    return "not a sensor's type" if topic.type.startswith(PASSED_OVER) else ""


def _add_reader(bag: Bag, name: str, block: Block, readers: dict[str, _FieldsReader], skipped: dict[str, str]) -> None:
    """Make the reader of a topic from its first message, or note why there is none."""
    topic = next(topic for topic in bag.topics if topic.name == name)
    if int(block.lengths[0]) > MAX_MESSAGE:
        skipped[name] = f"messages of {int(block.lengths[0])} bytes"
        return
    try:
        typestore = bag.typestore(topic)
        paths = tuple(list_fields(typestore.deserialize_cdr(block.payload(0), topic.type), topic.type, typestore))
    except CesError as error:
        skipped[name] = str(error).removeprefix(f"{bag.path}: ")
        return
    except DAMAGED as error:
        raise RecordingError(
            f"{bag.path}: topic {name}: a message cannot be decoded as {topic.type}: {error}"
        ) from None
    if paths:
        readers[name] = _FieldsReader(bag, topic, paths, typestore)
    else:
        skipped[name] = "no numbers"


def list_fields(message: object, typename: str, typestore: Typestore) -> Iterator[FieldPath]:
    """Yield the paths to the numbers of a message, without its header; the first 64."""
    for count, text in enumerate(_numbers(message, typename, typestore, "")):
        if count == MAX_FIELDS:
            return
        yield FieldPath.parse(text)


def _numbers(message: Any, typename: str, typestore: Typestore, prefix: str) -> Iterator[str]:
    fields = typestore.get_msgdef(typename).fields
    names = next((list(getattr(message, name)) for name, _ in fields if name in JOINT_NAMES), [])
    for name, description in fields:
        value, text = getattr(message, name), f"{prefix}{name}"
        if description == HEADER or name in ("layout", *JOINT_NAMES):
            continue
        if description[0] == Nodetype.BASE:
            if description[1][0] in NUMBERS:
                yield text
        elif description[0] == Nodetype.NAME:
            yield from _numbers(value, description[1], typestore, f"{text}.")
        else:
            yield from _elements(value, description[1][0], typestore, text, names)


def _elements(values: Any, element: Any, typestore: Typestore, text: str, names: list[Any]) -> Iterator[str]:
    """Yield the paths to the elements of an array: by joint name if there is one for each, else by index."""
    keys = names if len(names) == len(values) and all(map(_usable_joint, names)) else range(len(values))
    for i, key in enumerate(keys):
        if i == MAX_ELEMENTS:
            return
        if element[0] == Nodetype.NAME:
            yield from _numbers(values[i], element[1], typestore, f"{text}[{key}].")
        elif element[1][0] in NUMBERS:
            yield f"{text}[{key}]"


def _usable_joint(name: object) -> bool:
    return isinstance(name, str) and bool(name.strip()) and not set(name) & set("[].") and not name.isdigit()


class _FieldsReader:
    """Collects the numbers of one topic, block by block."""

    def __init__(
        self,
        bag: Bag,
        topic: Topic,
        paths: tuple[FieldPath, ...],
        typestore: Typestore,
        limit: int | None = MAX_SAMPLES,
    ) -> None:
        fields = dict(typestore.get_msgdef(topic.type).fields)
        self.stamp = STAMP if fields.get("header") == HEADER else ()
        self.topic, self.paths, self.limit = topic, paths, limit
        self.decoder = make_decoder(topic.type, (*self.stamp, *paths), typestore, f"{bag.path}: topic {topic.name}")
        self.count = 0
        self.header_ns: list[Index] = []
        self.log_ns: list[Index] = []
        self.values: list[Floats] = []

    @property
    def full(self) -> bool:
        """True if no more messages are read."""
        return self.limit is not None and self.count >= self.limit

    def add(self, block: Block) -> None:
        """Decode a block of this topic's messages."""
        if self.full:
            return
        values, _ = self.decoder.decode(block)
        self.count += len(block)
        header_ns = np.zeros(len(block), dtype=np.int64)
        if self.stamp:
            header_ns += values[:, 0].astype(np.int64) * 1_000_000_000 + values[:, 1].astype(np.int64)
        self.header_ns.append(header_ns)
        self.log_ns.append(block.log_ns)
        self.values.append(values[:, len(self.stamp) :])

    def reason(self, field: str) -> str:
        """Return why no message has a field."""
        at = [path.text for path in self.paths].index(field) + len(self.stamp)
        return self.decoder.reasons[at] or f"field '{field}': no messages"

    def series(self) -> Iterator[FieldSeries]:
        """Yield the series of each field that some message has."""
        if not self.values:
            return
        header_ns, values = np.concatenate(self.header_ns), np.concatenate(self.values)
        stamps = header_ns if header_ns.any() else np.concatenate(self.log_ns)
        for i, path in enumerate(self.paths):
            present = np.isfinite(values[:, i])
            if present.any():
                yield FieldSeries(self.topic.name, self.topic.type, path.text, stamps[present], values[present, i])
