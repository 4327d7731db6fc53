"""Raw messages (CDR) as storage files hold them, and the numbers in them: many at once where their layout is the same.

The lengths, texts and terminators in a serialised message determine the offsets of its numbers. Messages with the same
bytes there share a `MessageLayout`, which the walk of `ces_observer.cdr` finds and rosbags confirms; others are read
one by one.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.interfaces.typing import FieldDesc
from rosbags.serde import SerdeError
from rosbags.typesys.store import Typestore

from ces_data.limits import RecordingLimits
from ces_observer.cdr.layout import (
    ArrayPart,
    CdrUnsupportedError,
    MessagePart,
    NumberPart,
    OpaquePart,
    Part,
    TextPart,
    Walk,
    find_layout,
)
from ces_observer.errors import RecordingError, SignalsError
from ces_observer.signals import FieldPath

Bytes = NDArray[np.uint8]
Index = NDArray[np.int64]
Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

HEADER = (Nodetype.NAME, "std_msgs/msg/Header")
STAMP = ("header.stamp.sec", "header.stamp.nanosec")
LAYOUTS_PER_LENGTH = 16  # a topic with more layouts of one length, such as joint orders, is read one by one
CODES = {  # of the module struct
    **{"bool": "?", "byte": "b", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i"},
    **{"uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d"},
}
DAMAGED = (SerdeError, struct.error, ValueError, IndexError, AssertionError)  # rosbags before 0.11.9 raises others
IDL = MessageDefinitionFormat.IDL
FORMATS = {**dict.fromkeys(("ros2msg", "ros1msg"), MessageDefinitionFormat.MSG), "ros2idl": IDL, "omgidl": IDL}


@dataclass(frozen=True)
class StoredTopic:
    """A topic in a data file or in the bag's metadata: its number there, definition, encoding, number of messages.

    `publishers` is how many were there when it was recorded, 0 if that is not known.
    """

    id: int
    name: str
    type: str
    definition: MessageDefinition
    encoding: str
    count: int
    publishers: int = 0


def make_definition(kind: str, text: str) -> MessageDefinition:
    """Return the definition of a message in the format that storage files call `kind`; an unknown one is none."""
    return MessageDefinition(FORMATS.get(kind, MessageDefinitionFormat.NONE), text)


@dataclass(frozen=True)
class Block:
    """n raw messages in one buffer, in recorded order.

    `buffer` uint8; `topics` (the storage's number of the topic), `log_ns` (time logged), `starts` and `lengths`
    (of the payload in the buffer [bytes]), all int64 of shape (n,).
    """

    buffer: Bytes
    topics: Index
    log_ns: Index
    starts: Index
    lengths: Index

    @classmethod
    def join(cls, payloads: Sequence[bytes], topics: Sequence[int] | Index, log_ns: Sequence[int] | Index) -> Block:
        """Return the block of these messages."""
        lengths = np.array([len(payload) for payload in payloads], dtype=np.int64)
        buffer = np.frombuffer(b"".join(payloads) or b"\0", dtype=np.uint8)
        numbers, times = (np.asarray(column, dtype=np.int64) for column in (topics, log_ns))
        return cls(buffer, numbers, times, np.cumsum(lengths) - lengths, lengths)

    def select_topics(self, topics: Sequence[int]) -> Block:
        """Return the messages of these topics."""
        keep = np.isin(self.topics, topics)
        return Block(self.buffer, self.topics[keep], self.log_ns[keep], self.starts[keep], self.lengths[keep])

    def payload(self, i: int) -> bytes:
        """Return the bytes of message i."""
        return self.buffer[self.starts[i] : self.starts[i] + self.lengths[i]].tobytes()

    def __len__(self) -> int:
        return len(self.starts)


@dataclass(frozen=True)
class NumberField:
    """Offset from the message's start [bytes] and type of one number."""

    offset: int
    dtype: np.dtype[np.generic]

    def read(self, buffer: Bytes, starts: Index) -> Floats:
        """Return the number in each of the messages at `starts`, shape (n,)."""
        places = starts[:, None] + (self.offset + np.arange(self.dtype.itemsize))
        return np.asarray(buffer[places].view(self.dtype)[:, 0].astype(np.float64))


@dataclass(frozen=True)
class MessageLayout:
    """The offsets of the requested numbers, and the bytes that determine them.

    `fixed` (k,) are the positions of these bytes, `expected` (k,) their values. `numbers` has an entry for each
    requested number: its offset and type, or the reason (str) why messages of this layout do not have it. `names` are
    what the messages call the elements that are requested by index, '' where they have no names.
    """

    fixed: Index
    expected: Bytes
    numbers: tuple[NumberField | str, ...]
    names: tuple[str, ...] = ()


def describe_layout(raw: bytes, kind: str, paths: Sequence[FieldPath], typestore: Typestore) -> MessageLayout | None:
    """Return the layout of a message, None if none is found or rosbags disagrees; raises rosbags' SerdeError."""
    message = typestore.deserialize_cdr(raw, kind)
    record, buffer = _make_part((Nodetype.NAME, kind), typestore), np.frombuffer(raw, dtype=np.uint8)
    try:
        walk = Walk(raw, kind)
        walk.skip(record)
    except (CdrUnsupportedError, SignalsError):
        return None
    if not walk.at <= len(raw) < walk.at + 4 or not isinstance(record, MessagePart):
        return None
    numbers: list[NumberField | str] = []
    names = [""] * len(paths)
    for i, path in enumerate(paths):
        try:
            value, names[i] = path.read_named(message)
            place = find_layout(raw, record, path)
        except SignalsError as error:
            numbers.append(str(error))
            continue
        except CdrUnsupportedError:
            return None
        number = NumberField(place.offset, np.dtype(f"<{place.code}"))
        if not np.array_equal(number.read(buffer, np.zeros(1, np.int64))[0], value, equal_nan=True):
            return None
        numbers.append(number)
    fixed = np.unique(np.concatenate([np.arange(*span) for span in walk.fixed]))
    return MessageLayout(fixed, buffer[fixed], tuple(numbers), tuple(names))


def _make_part(description: FieldDesc, typestore: Typestore) -> Part:
    """Return a type of rosbags as the walk knows it."""
    match description:
        case (Nodetype.BASE, (kind, _)):
            if kind == "string":
                return TextPart(kind)
            return NumberPart(kind, CODES[kind]) if kind in CODES else OpaquePart(kind)
        case (Nodetype.NAME, str(name)):
            fields = typestore.get_msgdef(name).fields
            return MessagePart(name, {field: _make_part(of, typestore) for field, of in fields})
        case (kind, (element, count)):
            of, is_array = _make_part(element, typestore), kind == Nodetype.ARRAY
            return ArrayPart("array", of, count if is_array else None, None if is_array else count or None)
    raise TypeError(description)


def undecodable(where: str, kind: str, error: Exception) -> RecordingError:
    """Return the error for a message whose bytes are not those of its type."""
    remedy = "is the file damaged? Then copy it again"
    return RecordingError(f"{where}: a message cannot be decoded as {kind}: {error}; {remedy}")


class MessageDecoder:
    """Reads the stamp, if the type has a header, and the numbers at `paths` from every message of a topic.

    Raises RecordingError, which begins with `where`, for a message that cannot be decoded. `reasons` keeps the first
    reason why each number is missing.
    """

    def __init__(self, kind: str, paths: Sequence[FieldPath], typestore: Typestore, where: str = "") -> None:
        self.kind, self.typestore, self.where = kind, typestore, where
        stamped = dict(typestore.get_msgdef(kind).fields).get("header") == HEADER
        self.stamp = tuple(map(FieldPath.parse, STAMP)) if stamped else ()
        self.fields = tuple(paths)
        self.paths = (*self.stamp, *paths)
        self._reasons = [""] * len(self.paths)
        self._names, self._begun = [""] * len(self.paths), False
        self._others: list[Counter[str]] = [Counter() for _ in self.paths]
        self._layouts: dict[int, list[MessageLayout]] = {}
        self._one_by_one: set[int] = set()
        self.count = 0  # messages so far

    @property
    def reasons(self) -> list[str]:
        """The first reason why each number is missing, '' if none is."""
        return self._reasons[len(self.stamp) :]

    @property
    def names(self) -> list[str]:
        """What the first message calls each element that is taken by index, '' without names."""
        return self._names[len(self.stamp) :]

    @property
    def others(self) -> list[Counter[str]]:
        """How many messages call the element otherwise; these have no number."""
        return self._others[len(self.stamp) :]

    def mixed(self) -> Iterator[tuple[str, str]]:
        """Yield the fields that another element has in 1 % of the messages so far, and what the messages call them."""
        for path, name, others in zip(self.fields, self.names, self.others, strict=True):
            if others.total() >= max(1, RecordingLimits.CONTRADICTED_SHARE * self.count):
                listed = ", ".join(f"'{other}' in {n}" for other, n in others.most_common(3))
                yield path.text, f"is '{name}' first, and {listed} of {self.count} messages"

    def _name_of(self, raw: bytes, path: FieldPath) -> str:
        if not any(isinstance(element, int) for _, element in path.steps):
            return ""
        try:
            return path.read_named(self.typestore.deserialize_cdr(raw, self.kind))[1]
        except SignalsError:
            return ""
        except DAMAGED as error:
            raise undecodable(self.where, self.kind, error) from None

    def _contradicts(self, i: int, name: str, count: int) -> bool:
        """Return whether so many messages have another name at number i than the first message."""
        differs = bool(name and self._names[i]) and name != self._names[i]
        if differs:
            self._others[i][name] += count
        return differs

    def decode(self, block: Block) -> tuple[Index, Floats, Mask]:
        """Return the header stamps [ns] of n messages (n,), 0 without; numbers and the mask of those present (n, k)."""
        if not self._begun and len(block):
            self._begun, first = True, block.payload(0)
            self._names = [self._name_of(first, path) for path in self.paths]
        self.count += len(block)
        values = np.full((len(block), len(self.paths)), np.nan)
        present = np.zeros(values.shape, dtype=np.bool_)
        for length in map(int, np.unique(block.lengths)):
            rows = np.flatnonzero(block.lengths == length)
            for layout in self._layouts.setdefault(length, []):
                rows = self._fill(layout, block, rows, values, present)
            try:
                self._learn(length, block, rows, values, present)
            except DAMAGED as error:
                raise undecodable(self.where, self.kind, error) from None
        stamps = np.zeros(len(block), dtype=np.int64)
        if self.stamp:
            stamps += values[:, 0].astype(np.int64) * 1_000_000_000 + values[:, 1].astype(np.int64)
        return stamps, values[:, len(self.stamp) :], present[:, len(self.stamp) :]

    def read_one(self, raw: bytes) -> list[float | str]:
        """Return the numbers of a raw message, or the reason (str) for each that it does not have."""
        numbers: list[float | str] = []
        message = self.typestore.deserialize_cdr(raw, self.kind)
        for i, path in enumerate(self.paths):
            try:
                number, name = path.read_named(message)
                numbers.append(f"another joint, {name}" if self._contradicts(i, name, 1) else number)
            except SignalsError as error:
                numbers.append(str(error))
        return numbers

    def _learn(self, length: int, block: Block, rows: Index, values: Floats, present: Mask) -> None:
        """Read the rows by new layouts, or one by one if there is none."""
        layouts = self._layouts[length]
        while len(rows) and len(layouts) < LAYOUTS_PER_LENGTH and length not in self._one_by_one:
            layout = describe_layout(block.payload(rows[0]), self.kind, self.paths, self.typestore)
            if layout is None:
                self._one_by_one.add(length)
                break
            layouts.append(layout)
            rows = self._fill(layout, block, rows, values, present)
        for row in rows:
            numbers = self.read_one(block.payload(row))
            self._note(numbers)
            present[row] = [not isinstance(number, str) for number in numbers]
            values[row] = [np.nan if isinstance(number, str) else number for number in numbers]

    def _fill(self, layout: MessageLayout, block: Block, rows: Index, values: Floats, present: Mask) -> Index:
        """Read the rows that have this layout; return the others."""
        if not len(rows):
            return rows
        fits = (block.buffer[block.starts[rows][:, None] + layout.fixed] == layout.expected).all(axis=1)
        mine = rows[fits]
        self._note(layout.numbers)
        for i, number in enumerate(layout.numbers):
            if len(mine) and not isinstance(number, str) and not self._contradicts(i, layout.names[i], len(mine)):
                values[mine, i] = number.read(block.buffer, block.starts[mine])
                present[mine, i] = True
        return np.asarray(rows[~fits])

    def _note(self, numbers: Sequence[NumberField | float | str]) -> None:
        for i, number in enumerate(numbers):
            self._reasons[i] = self._reasons[i] or (number if isinstance(number, str) else "")


class TopicSamples:
    """Collects the stamps and numbers of one topic: `count` messages so far, and the bytes of the first."""

    def __init__(self, decoder: MessageDecoder) -> None:
        self.decoder = decoder
        self.count, self.first = 0, b""
        self._columns = [bytearray() for _ in range(4)]  # grow in place, so that a long recording is held once

    def add(self, block: Block) -> None:
        """Decode a block of this topic's messages."""
        self.first = self.first or block.payload(0)
        stamps, values, present = self.decoder.decode(block)
        for column, more in zip(self._columns, (stamps, block.log_ns, values, present), strict=True):
            column.extend(more.tobytes())
        self.count += len(block)

    def join(self) -> tuple[Index, Index, Floats, Mask]:
        """Return header stamps and log times [ns] (n,), numbers and the mask of those present (n, k)."""
        header_ns, log_ns, values, present = self._columns
        shape = self.count, len(self.decoder.reasons)
        numbers, known = np.frombuffer(values, np.float64), np.frombuffer(present, np.bool_)
        stamps, logged = np.frombuffer(header_ns, np.int64), np.frombuffer(log_ns, np.int64)
        return stamps, logged, numbers.reshape(shape), known.reshape(shape)
