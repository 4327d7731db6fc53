"""Recordings and results into bags: rosbag2 folders with MCAP storage for Foxglove, PlotJuggler and ros2 bag.

A bag is written to a temporary folder beside its final place and renamed when it is complete.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

import numpy as np
import yaml
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from ces_data.bags.decode import HEADER, STAMP, Bytes, Index, NumberField, describe_layout
from ces_data.bags.storage import METADATA, WRITTEN_BY
from ces_data.recording import Recording, Stamps, Values
from ces_observer import __version__
from ces_observer.errors import CesError, OptionName, RecordingError, SignalsError
from ces_observer.signals import NAMES_BESIDE, FieldPath, Signal, Signals

CHUNK = 1 << 20  # bytes of messages that are compressed together
MESSAGE = 5  # opcode of an MCAP record; before the payload: length, channel, sequence, log time, publish time
PREFIX = np.dtype("<u1,<u8,<u2,<u4,<u8,<u8")
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
        leading, columns = recording.channel(mine[0].name), {}
        stamps_ns = leading.stamps_ns + mine[0].delay_ns
        for signal in mine:
            channel = recording.channel(signal.name)
            if not np.array_equal(channel.stamps_ns + signal.delay_ns, stamps_ns):
                text = f"{leading.name} and {channel.name} share topic {name} but not their stamps"
                raise RecordingError(f"{recording.name}: {text}")
            columns[signal.field.text] = (channel.values - signal.offset) / signal.scale
        topics.append(TopicData(name, kind, stamps_ns, columns))
    return tuple(topics)


def write_bag(
    path: Path, topics: Sequence[TopicData], *, overwrite: bool = False, notes: Mapping[str, str] | None = None
) -> None:
    """Write a bag folder with these topics, in time order; `notes` become the bag's custom metadata.

    Raises RecordingError and SignalsError as `open_bag_writer` and its `write` do.
    """
    with open_bag_writer(path, overwrite=overwrite, notes=notes) as writer:
        writer.write(topics)


@contextmanager
def open_bag_writer(
    path: Path, *, overwrite: bool = False, notes: Mapping[str, str] | None = None
) -> Iterator[BagWriter]:
    """Open a bag folder for messages; it gets its name at the end of the block, and nothing remains after an error.

    Raises RecordingError if `path` holds anything but a bag to overwrite, or if the folder cannot be written.
    """
    used = path.exists() and not (path.is_dir() and not any(path.iterdir()))
    if used and not overwrite:
        replace = OptionName("overwrite", True)
        raise RecordingError(f"{path}: exists; choose another name, or replace it with ", replace)
    if used and not (path / METADATA).exists():
        raise RecordingError(f"{path}: exists and is not a bag, so it is not overwritten; choose another name")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
            part = Path(folder) / path.name
            part.mkdir()
            with (part / f"{path.name}.mcap").open("wb") as file:
                writer = BagWriter(file)
                yield writer
                metadata = writer.finish(path.name, notes or {})
            (part / METADATA).write_text(metadata, encoding="utf-8")
            _move_into_place(part, path, overwrite)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror or error}; choose another place") from None


def _move_into_place(part: Path, path: Path, overwrite: bool) -> None:
    """Rename the finished bag to its name; one to overwrite is moved aside first and restored if that fails."""
    aside = part.with_name(f"{path.name}.old")
    if overwrite and path.exists():
        path.rename(aside)
    try:
        part.rename(path)
    except OSError:
        if aside.exists():
            aside.rename(path)
        raise


class BagWriter:
    """Writes messages into the bag of `open_bag_writer`."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._typestore = McapFile(file), get_typestore(Stores.ROS2_JAZZY)
        self._encoders: dict[tuple[str, str], _Encoder] = {}

    def write(self, topics: Sequence[TopicData]) -> None:
        """Write messages in time order, those of a topic in their own order even if its stamps run backwards.

        Each call continues the topics of the one before. Raises SignalsError if a type or field path cannot be written.
        """
        for topic in (t for t in topics if (t.name, t.type) not in self._encoders):
            encoder = self._encoders[topic.name, topic.type] = _Encoder(topic, self._typestore)
            definition = self._typestore.generate_msgdef(topic.type, ros_version=2)[0]
            encoder.channel = self._file.add_channel(f"/{topic.name.lstrip('/')}", topic.type, definition)
        encoders = [self._encoders[topic.name, topic.type] for topic in topics]
        orders = [encoder.latest_so_far(topic) for encoder, topic in zip(encoders, topics, strict=True)]
        longest = max(orders, key=len, default=np.empty(0, dtype=np.int64))
        step = max(1, CHUNK // max(1, sum(encoder.size for encoder in encoders)))
        begins = [0] * len(topics)
        for edge in [*longest[step::step].tolist(), None]:
            ends = [len(order) if edge is None else int(np.searchsorted(order, edge)) for order in orders]
            parts = [slice(begin, end) for begin, end in zip(begins, ends, strict=True)]
            if sum(ends) > sum(begins):
                rows = [e.records(topic, part) for e, topic, part in zip(encoders, topics, parts, strict=True)]
                starts, records = _merge(rows, [order[part] for order, part in zip(orders, parts, strict=True)])
                times = [topic.stamps_ns[part] for topic, part in zip(topics, parts, strict=True)]
                channels = [encoder.channel for encoder in encoders]
                self._file.write_chunk(records, dict(zip(channels, zip(times, starts, strict=True), strict=True)))
            begins = ends

    def finish(self, name: str, notes: Mapping[str, str]) -> str:
        """Write the end of the file; return the bag's metadata.yaml, with `notes` and the writer as custom data."""
        (first, last), counts = self._file.span_ns, self._file.counts
        span = {"starting_time": {"nanoseconds_since_epoch": first}, "duration": {"nanoseconds": last - first}}
        span["message_count"] = sum(counts.values())  # type: ignore[assignment]
        described = [
            {
                "topic_metadata": {
                    "name": f"/{topic.lstrip('/')}",
                    "type": kind,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [],
                    "type_description_hash": self._typestore.hash_rihs01(kind),
                },
                "message_count": counts[encoder.channel],
            }
            for (topic, kind), encoder in self._encoders.items()
        ]
        facts = {
            "version": 9,
            "storage_identifier": "mcap",
            "relative_file_paths": [f"{name}.mcap"],
            **span,
            "topics_with_message_count": described,
            "compression_format": "",
            "compression_mode": "",
            "files": [{"path": f"{name}.mcap", **span}],
            "custom_data": {**notes, WRITTEN_BY: f"ces_observer {__version__}"},
            "ros_distro": "rosbags",
        }
        dumper = type("Dumper", (yaml.SafeDumper,), {"ignore_aliases": lambda *_: True})
        self._file.finish(yaml.dump(facts, Dumper=dumper, sort_keys=False))
        return yaml.dump({"rosbag2_bagfile_information": facts}, Dumper=dumper, sort_keys=False)


def _merge(rows: Sequence[Bytes], times: Sequence[Stamps]) -> tuple[list[Index], Bytes]:
    """Return the offset of each row by topic, and the bytes of all rows by time, then topic."""
    order = np.argsort(np.concatenate(times), kind="stable")
    sizes = np.repeat([part.shape[1] for part in rows], [len(part) for part in rows])[order]
    ends = np.cumsum(sizes)
    starts = np.empty(len(order), dtype=np.int64)
    starts[order] = ends - sizes
    records = np.empty(ends[-1], dtype=np.uint8)
    by_topic = np.split(starts, np.cumsum([len(part) for part in rows])[:-1])
    for part, begins in zip(rows, by_topic, strict=True):
        records[begins[:, None] + np.arange(part.shape[1])] = part
    return by_topic, records


class _Encoder:
    """Serialises the messages of one topic: the bytes of a blank message with the numbers inserted."""

    channel = 0  # its number in the file

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
        self.stamped, self.blank = stamped, np.frombuffer(raw, dtype=np.uint8)
        self.size = PREFIX.itemsize + len(raw)
        self.numbers = [number for number in numbers if isinstance(number, NumberField)]
        self._latest = 0

    def latest_so_far(self, topic: TopicData) -> Stamps:
        """Return the latest stamp up to each message, by which topics are merged."""
        latest = np.maximum(np.maximum.accumulate(topic.stamps_ns), self._latest)
        self._latest = int(latest[-1]) if len(latest) else self._latest
        return latest

    def records(self, topic: TopicData, part: slice) -> Bytes:
        """Return the records (n, bytes) of the messages of a part."""
        stamps, begin = topic.stamps_ns[part], PREFIX.itemsize
        prefix = np.zeros(len(stamps), dtype=PREFIX)
        columns: list[Any] = [MESSAGE, self.size - 9, self.channel, 0, stamps, stamps]
        for name, column in zip(prefix.dtype.names or (), columns, strict=True):
            prefix[name] = column
        rows = np.empty((len(stamps), self.size), dtype=np.uint8)
        rows[:, :begin], rows[:, begin:] = prefix.view(np.uint8).reshape(-1, begin), self.blank
        times = [stamps // SECOND, stamps % SECOND] if self.stamped else []
        values = [*times, *(column[part] for column in topic.columns.values())]
        for number, column in zip(self.numbers, values, strict=True):
            whole = np.rint(column) if number.dtype.kind in "iu" else column
            first, size = begin + number.offset, number.dtype.itemsize
            raw = np.ascontiguousarray(whole.astype(number.dtype)).view(np.uint8).reshape(len(column), size)
            rows[:, first : first + size] = raw
        return rows


def blank_message(typename: str, paths: Sequence[tuple[str, Steps]], typestore: Typestore) -> object:
    """Return a message in which every path (text and steps) can be read: arrays long enough, joints named, else zero.

    Raises SignalsError if a path names a joint in a message without joint names.
    """
    fields = typestore.get_msgdef(typename).fields
    holder = next((name for name, _ in fields if name in NAMES_BESIDE), None)
    joints: list[str] = []
    inner: dict[str, list[tuple[int, tuple[str, Steps]]]] = {name: [] for name, _ in fields}
    for text, ((name, element), *deeper) in ((text, steps) for text, steps in paths if steps):
        if isinstance(element, str):
            if holder is None:
                raise SignalsError(
                    f"field '{text}': {typename} has no joint names; give the index instead of '{element}'"
                )
            joints += [] if element in joints else [element]
            element = joints.index(element)  # noqa: PLW2901 - the index that the name stands for
        inner.setdefault(name, []).append((element or 0, (text, tuple(deeper))))
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


class McapFile:
    """An MCAP file of ROS 2 that is being written: its channels first, then chunks of messages, then `finish`."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._builder, self._compressor = file, RecordBuilder(), zstandard.ZstdCompressor()
        self._schemas: dict[str, records.Schema] = {}
        self._channels: list[records.Channel] = []
        self._chunks: list[records.ChunkIndex] = []
        self.counts: dict[int, int] = {}
        file.write(MCAP0_MAGIC)
        self._write(records.Header("ros2", f"ces_observer {__version__}"))

    def add_channel(self, topic: str, kind: str, definition: str) -> int:
        """Return the number of a new channel for messages of the type `kind`, as its .msg `definition` says."""
        if kind not in self._schemas:
            self._schemas[kind] = records.Schema(len(self._schemas) + 1, definition.encode(), "ros2msg", kind)
            self._write(self._schemas[kind])
        number = len(self._channels) + 1
        channel = records.Channel(number, topic, "cdr", {"offered_qos_profiles": "[]"}, self._schemas[kind].id)
        self._channels.append(channel)
        self.counts[number] = 0
        self._write(channel)
        return number

    def write_chunk(self, buffer: Bytes, messages: Mapping[int, tuple[Index, Index]]) -> None:
        """Write a chunk of message records; `messages` has the log times [ns] and offsets of each channel."""
        times = [log_ns for log_ns, _ in messages.values() if len(log_ns)]
        first, last = (int(f([f(one) for one in times])) for f in (np.min, np.max))
        data, at = self._compressor.compress(buffer.data), self._file.tell()
        length = self._write(records.Chunk("zstd", data, last, first, zlib.crc32(buffer.data), len(buffer)))
        offsets: dict[int, int] = {}
        for channel, (log_ns, starts) in messages.items():
            if len(log_ns):
                offsets[channel] = self._file.tell()
                entries = np.stack([log_ns, starts], axis=1).astype("<u8").tobytes()
                self._file.write(
                    struct.pack("<BQHI", Opcode.MESSAGE_INDEX, len(entries) + 6, channel, len(entries)) + entries
                )
                self.counts[channel] += len(log_ns)
        indexes = self._file.tell() - at - length
        self._chunks.append(
            records.ChunkIndex(length, at, "zstd", len(data), last, indexes, offsets, first, len(buffer))
        )

    @property
    def span_ns(self) -> tuple[int, int]:
        """The first and last log time [ns], (0, 0) without messages."""
        firsts, lasts = ([getattr(c, f"message_{end}_time") for c in self._chunks] for end in ("start", "end"))
        return min(firsts, default=0), max(lasts, default=0)

    def finish(self, metadata: str) -> None:
        """Write the bag's metadata, the summary and the footer."""
        at = self._file.tell()
        stored = records.MetadataIndex(
            at, self._write(records.Metadata("rosbag2", {"serialized_metadata": metadata})), "rosbag2"
        )
        self._write(records.DataEnd(0))
        (first, last), sizes = self.span_ns, (len(self._schemas), len(self._channels), len(self._chunks))
        statistics = records.Statistics(
            0, sizes[1], self.counts, sizes[2], sum(self.counts.values()), last, first, 1, sizes[0]
        )
        groups: dict[int, Sequence[records.McapRecord]] = {
            Opcode.SCHEMA: list(self._schemas.values()),
            Opcode.CHANNEL: self._channels,
            Opcode.CHUNK_INDEX: self._chunks,
            Opcode.METADATA_INDEX: [stored],
            Opcode.STATISTICS: [statistics],
        }
        summary, offsets = self._file.tell(), []
        for opcode, group in groups.items():
            start = self._file.tell()
            offsets += [records.SummaryOffset(opcode, start, sum(map(self._write, group)))] if group else []
        footer = records.Footer(summary, self._file.tell(), 0)
        for record in (*offsets, footer):
            self._write(record)
        self._file.write(MCAP0_MAGIC)

    def _write(self, record: records.McapRecord) -> int:
        """Write a record; return its length."""
        record.write(self._builder)
        data: bytes = self._builder.end()  # type: ignore[no-untyped-call]
        return self._file.write(data)
