"""Recordings and results into bags: rosbag2 folders with MCAP storage for Foxglove, PlotJuggler and ros2 bag.

A bag is written to a temporary folder beside its final place and renamed when it is complete.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from ces_data.bags.decode import HEADER, STAMP, NumberField, describe_layout
from ces_data.bags.storage import WRITTEN_BY
from ces_data.recording import Recording, Stamps, Values
from ces_observer import __version__
from ces_observer.cdr.types import JOINT_NAMES
from ces_observer.errors import CesError, RecordingError, SignalsError
from ces_observer.signals import FieldPath, Signal, Signals

BATCH = 1_000  # messages of a topic encoded at a time
SECOND = 1_000_000_000
Steps = tuple[tuple[str, int | str | None], ...]  # of a field path


@dataclass(frozen=True)
class TopicData:
    """The messages of one topic.

    `stamps_ns` int64 (n,) go into the header, if the type has one, and become the log times; `columns` maps field
    paths, such as `position[rear_damper]`, to float64 (n,). Everything else in the messages is zero or empty.
    """

    name: str
    type: str
    stamps_ns: Stamps
    columns: Mapping[str, Values]

    def __post_init__(self) -> None:
        stamps = np.asarray(self.stamps_ns, dtype=np.int64)
        columns = {path: np.asarray(values, dtype=np.float64) for path, values in self.columns.items()}
        for path, values in columns.items():
            if stamps.ndim != 1 or values.shape != stamps.shape:
                raise RecordingError(f"topic {self.name}: {path} has shape {values.shape}; expected {stamps.shape}")
        if len(stamps) and stamps.min() < 0:
            raise RecordingError(f"topic {self.name}: a stamp is {stamps.min()} ns; a bag has no times before 0")
        object.__setattr__(self, "stamps_ns", stamps)
        object.__setattr__(self, "columns", columns)


def recording_topics(recording: Recording, signals: Signals) -> tuple[TopicData, ...]:
    """Return the topics of a recording's channels as `signals` describes them, with scale, offset and delay undone.

    Raises RecordingError if two channels share a topic but not their stamps.
    """
    shared: dict[tuple[str, str], list[Signal]] = {}
    for signal in signals.list_topic_signals():
        if signal.name in recording.channels:
            shared.setdefault((signal.topic, signal.type), []).append(signal)
    topics = []
    for (name, kind), mine in shared.items():
        first, columns = recording.channel(mine[0].name), {}
        stamps_ns = first.stamps_ns + mine[0].delay_ns
        for signal in mine:
            channel = recording.channel(signal.name)
            if not np.array_equal(channel.stamps_ns + signal.delay_ns, stamps_ns):
                text = f"{first.name} and {channel.name} share topic {name} but not their stamps"
                raise RecordingError(f"{recording.name}: {text}")
            columns[signal.field.text] = (channel.values - signal.offset) / signal.scale
        topics.append(TopicData(name, kind, stamps_ns, columns))
    return tuple(topics)


def write_bag(
    path: Path, topics: Sequence[TopicData], *, overwrite: bool = False, notes: Mapping[str, str] | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> None:  # fmt: skip
    """Write a bag folder with these topics, in time order; `notes` become the bag's custom metadata.

    `progress` is called with the share of the messages that is written. The order within a topic is kept even if its
    stamps run backwards. Raises RecordingError if `path` holds anything but a bag to overwrite, or if the folder cannot
    be written; SignalsError if a type or field path cannot be written.
    """
    used = path.exists() and not (path.is_dir() and not any(path.iterdir()))
    if used and not overwrite:
        raise RecordingError(f"{path}: exists; choose another name, or replace it with --overwrite (overwrite=True)")
    if used and not (path / "metadata.yaml").exists():
        raise RecordingError(f"{path}: exists and is not a bag, so it is not overwritten; choose another name")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
            part = Path(folder) / path.name
            _write(part, topics, notes or {}, progress)
            _move_into_place(part, path)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror or error}; choose another place") from None


def _move_into_place(part: Path, path: Path) -> None:
    """Rename the finished bag to its name; an older one is moved aside first and restored if that fails."""
    aside = part.with_name(f"{path.name}.old")
    if path.exists():
        path.rename(aside)
    try:
        part.rename(path)
    except OSError:
        if aside.exists():
            aside.rename(path)
        raise


def _write(path: Path, topics: Sequence[TopicData], notes: Mapping[str, str], report: Callable[[float], None]) -> None:
    typestore = get_typestore(Stores.ROS2_JAZZY)
    encoders = [_Encoder(topic, typestore) for topic in topics]
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    for key, value in {**notes, WRITTEN_BY: f"ces_observer {__version__}"}.items():
        writer.set_custom_data(key, value)
    with writer:
        connections = [
            writer.add_connection(f"/{topic.name.lstrip('/')}", topic.type, typestore=typestore) for topic in topics
        ]
        total = sum(len(topic.stamps_ns) for topic in topics)
        count = 0
        for batch in _batches(encoders):
            for i, stamp, payload in batch:
                writer.write(connections[i], stamp, payload)
                count += 1
                if count % BATCH == 0 or count == total:
                    report(count / total)


def _batches(encoders: Sequence[_Encoder]) -> Iterator[list[tuple[int, int, bytes]]]:
    """Yield topic index, stamp and payload of all messages by time, then topic; 1,000 of the longest a batch."""
    longest = max((encoder.order for encoder in encoders), key=len, default=np.empty(0, dtype=np.int64))
    edges = [*longest[BATCH::BATCH].tolist(), None]
    begins = [0] * len(encoders)
    for edge in edges:
        ends = [len(e.order) if edge is None else int(np.searchsorted(e.order, edge)) for e in encoders]
        parts = [slice(begin, end) for begin, end in zip(begins, ends, strict=True)]
        rows = [row for i, part in enumerate(parts) for row in encoders[i].messages(i, part)]
        times = [encoder.order[part] for encoder, part in zip(encoders, parts, strict=True)]
        order = np.argsort(np.concatenate(times), kind="stable") if times else ()
        yield [rows[at] for at in order]
        begins = ends


class _Encoder:
    """Serialises the messages of one topic: the bytes of a blank message with the numbers inserted."""

    def __init__(self, topic: TopicData, typestore: Typestore) -> None:
        if topic.type not in typestore.fielddefs:
            raise SignalsError(f"topic {topic.name}: cannot write {topic.type}; it is not a type of ROS 2 Jazzy")
        stamped = dict(typestore.get_msgdef(topic.type).fields).get("header") == HEADER
        paths = [FieldPath.parse(text) for text in (*(STAMP if stamped else ()), *topic.columns)]
        try:
            blank = blank_message(topic.type, [(path.text, path.steps) for path in paths], typestore)
            raw = bytes(typestore.serialize_cdr(blank, topic.type))
            layout = describe_layout(raw, topic.type, paths, typestore)
        except CesError as error:
            raise SignalsError(f"topic {topic.name}: {error}") from None
        numbers = layout.numbers if layout else tuple(f"field '{path.text}' cannot be written" for path in paths)
        if missing := [number for number in numbers if isinstance(number, str)]:
            raise SignalsError(f"topic {topic.name}: {topic.type}: {missing[0]}")
        self.topic, self.stamped, self.blank = topic, stamped, np.frombuffer(raw, dtype=np.uint8)
        self.numbers = [number for number in numbers if isinstance(number, NumberField)]
        self.order = np.maximum.accumulate(topic.stamps_ns)  # the latest stamp so far

    def messages(self, index: int, part: slice) -> Iterator[tuple[int, int, bytes]]:
        """Yield `index`, stamp and payload of each message of a part."""
        stamps = self.topic.stamps_ns[part]
        times = [stamps // SECOND, stamps % SECOND] if self.stamped else []
        rows = np.tile(self.blank, (len(stamps), 1))
        columns = [*times, *(values[part] for values in self.topic.columns.values())]
        for number, column in zip(self.numbers, columns, strict=True):
            whole = np.rint(column) if number.dtype.kind in "iu" else column
            size = number.dtype.itemsize
            raw = np.ascontiguousarray(whole.astype(number.dtype)).view(np.uint8).reshape(len(column), size)
            rows[:, number.offset : number.offset + size] = raw
        payloads, width = rows.tobytes(), len(self.blank)
        for i, stamp in enumerate(stamps.tolist()):
            yield index, stamp, payloads[i * width : (i + 1) * width]


def blank_message(typename: str, paths: Sequence[tuple[str, Steps]], typestore: Typestore) -> object:
    """Return a message in which every path (text and steps) can be read: arrays long enough, joints named, else zero.

    Raises SignalsError if a path names a joint in a message without joint names.
    """
    fields = typestore.get_msgdef(typename).fields
    holder = next((name for name, _ in fields if name in JOINT_NAMES), None)
    joints: list[str] = []
    inner: dict[str, list[tuple[int, tuple[str, Steps]]]] = {name: [] for name, _ in fields}
    for text, ((name, element), *rest) in ((text, steps) for text, steps in paths if steps):
        if isinstance(element, str):
            if holder is None:
                raise SignalsError(
                    f"field '{text}': {typename} has no joint names; give the index instead of '{element}'"
                )
            joints += [] if element in joints else [element]
            element = joints.index(element)  # noqa: PLW2901 - the index that the name stands for
        inner.setdefault(name, []).append((element or 0, (text, tuple(rest))))
    values = {name: _blank_value(description, inner[name], typestore) for name, description in fields}
    if holder is not None and joints:
        values[holder] = joints
    return typestore.types[typename](**values)


def _blank_value(description: FieldDesc, paths: list[tuple[int, tuple[str, Steps]]], typestore: Typestore) -> Any:
    """Return an empty value for a field in which the paths, each behind the index of its element, can be read."""
    kind, of = description
    content: Any = of  # what it is depends on the kind, which the types of rosbags do not say
    if kind == Nodetype.BASE:
        return {"string": "", "bool": False}.get(content[0], 0)
    if kind == Nodetype.NAME:
        return blank_message(str(content), [path for _, path in paths], typestore)
    element, size = content
    length = size if kind == Nodetype.ARRAY else max((1 + index for index, _ in paths), default=0)
    if element[0] == Nodetype.NAME:
        parts = [[path for index, path in paths if index == i] for i in range(length)]
        return [blank_message(str(element[1]), part, typestore) for part in parts]
    if element[1][0] == "string":
        return [""] * length
    return np.zeros(length, dtype={"byte": "int8", "char": "uint8"}.get(element[1][0], element[1][0]))
