"""A walk along the bytes of a serialised message (CDR, little endian) that records which bytes determine its layout.

The bytes are not trusted: every length is compared with the bytes that are left, and the number of parts is limited.
Source: OMG DDSI-RTPS 2.5, section 10 (encapsulation), and Common Object Request Broker Architecture 3.4, part 2,
section 9.3 (CDR: each number aligned to its size, counted from the end of the encapsulation).
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from ces_observer.errors import SignalsError
from ces_observer.signals import NAMES_BESIDE, FieldPath

FieldsOf = Callable[[str], Mapping[str, str]]  # raises LookupError for an unknown type
KINDS = "boolean octet char int8 uint8 int16 uint16 int32 uint32 int64 uint64 float double"
CODES = dict(zip(KINDS.split(), "?BBbBhHiIqQfd", strict=True))  # of the module struct

_SEQUENCE = re.compile(r"sequence<(.+?)(?:, (\d+))?>")
_ARRAY = re.compile(r"(.+)\[(\d+)\]")
_TEXT = re.compile(r"string(<\d+>)?")


class CdrUnsupportedError(Exception):
    """A message that cannot be read here and has to be deserialised; it need not be faulty."""


@dataclass(frozen=True)
class NumberPart:
    """One number; `code` is its type in the module struct."""

    kind: str
    code: str
    fixed = True  # in length, apart from the padding before it

    @property
    def size(self) -> int:
        """Number of bytes, and alignment."""
        return struct.calcsize(f"<{self.code}")


@dataclass(frozen=True)
class TextPart:
    """A string of 8-bit characters."""

    kind: str
    fixed = False


@dataclass(frozen=True)
class OpaquePart:
    """A part of unknown length: wstring, long double, a type that is not installed."""

    kind: str
    fixed = False


@dataclass(frozen=True)
class ArrayPart:
    """An array of `count` elements or, if `count` is None, a sequence of at most `max_count` (None: any number)."""

    kind: str
    element: Part
    count: int | None
    max_count: int | None = None

    @property
    def fixed(self) -> bool:
        """True if its length is the same in every message."""
        return self.count is not None and self.element.fixed


@dataclass(frozen=True)
class MessagePart:
    """A message, or a message within a message."""

    kind: str
    fields: Mapping[str, Part]

    @property
    def fixed(self) -> bool:
        """True if its length is the same in every message."""
        return all(part.fixed for part in self.fields.values())


Part = NumberPart | TextPart | OpaquePart | ArrayPart | MessagePart


def parse_message_type(type_name: str, fields_of: FieldsOf) -> MessagePart:
    """Return the tree of a message type; raises CdrUnsupportedError if the type is unknown."""
    record = parse_part(type_name, fields_of)
    if not isinstance(record, MessagePart):
        raise CdrUnsupportedError(f"the fields of '{type_name}' are not known")
    return record


def parse_part(kind: str, fields_of: FieldsOf) -> Part:
    """Return the tree of a type string."""
    if sequence := _SEQUENCE.fullmatch(kind):
        return ArrayPart(kind, parse_part(sequence[1], fields_of), None, int(sequence[2]) if sequence[2] else None)
    if array := _ARRAY.fullmatch(kind):
        return ArrayPart(kind, parse_part(array[1], fields_of), int(array[2]))
    if kind in CODES:
        return NumberPart(kind, CODES[kind])
    if _TEXT.fullmatch(kind):
        return TextPart(kind)
    try:
        return MessagePart(kind, {name: parse_part(of, fields_of) for name, of in fields_of(kind).items()})
    except LookupError:
        return OpaquePart(kind)


def find_number(record: MessagePart, path: FieldPath) -> NumberPart:
    """Return the type of the number at `path`.

    Raises SignalsError, as `path.read` does, if messages of this type hold no number there, and CdrUnsupportedError if
    they may hold something that `path.read` converts to one, such as a string.
    """
    part: Part = record
    for name, element in path.steps:
        if not isinstance(part, MessagePart) or name not in part.fields:
            raise SignalsError(f"field '{path.text}': no '{name}' in {part.kind.rpartition('/')[2]}")
        parent, part = part, part.fields[name]
        if element is not None:
            part = _find_element(parent, part, path, element)
    if isinstance(part, ArrayPart | MessagePart):
        raise SignalsError(f"field '{path.text}' is a {part.kind}, not a number")
    if not isinstance(part, NumberPart) or part.kind == "octet":
        raise CdrUnsupportedError(f"field '{path.text}' is a {part.kind}")
    return part


def _find_element(parent: MessagePart, array: Part, path: FieldPath, element: int | str) -> Part:
    if not isinstance(array, ArrayPart):
        raise CdrUnsupportedError(f"field '{path.text}': [{element}] of a {array.kind}")
    if isinstance(element, str):
        names = [parent.fields[field] for field in NAMES_BESIDE if field in parent.fields]
        if not names:
            raise SignalsError(f"field '{path.text}': no joint '{element}'; the message has no names")
        if not all(map(_is_texts, names)):
            raise CdrUnsupportedError(f"field '{path.text}': the joints of {parent.kind} are not named by strings")
    return array.element


ENCAPSULATION = 4  # bytes before the message: representation (2, big endian) and options (2)
PLAIN_CDR_LITTLE = 0x0001
KNOWN_REPRESENTATIONS = range(0x000C)  # either byte order, parameter lists, XML, XCDR 2
MAX_PARTS = 10_000  # a longer walk takes longer than deserialising in C
LENGTH = NumberPart("uint32", "I")

Span = tuple[int, int]  # of bytes: start and end, counted from the first byte of the encapsulation


class Walk:
    """A position `at` in the bytes of one message.

    `fixed` are the spans passed that determine the layout, `padding` maps start to end of the padding passed, `where`
    begins each error. Methods raise SignalsError if the message is malformed, and CdrUnsupportedError if it has to be
    deserialised instead.
    """

    def __init__(self, raw: bytes, where: str) -> None:
        self.raw = raw
        self.where = where
        self.at = 0
        self.fixed: list[Span] = []
        self.padding: dict[int, int] = {}
        self._parts = 0
        self.fixed.append((self._skip_bytes(ENCAPSULATION), self.at))
        representation = int.from_bytes(raw[:2], "big")
        if representation not in KNOWN_REPRESENTATIONS:
            raise self._malformed_error(f"representation {representation:#06x}")
        if representation != PLAIN_CDR_LITTLE:
            raise CdrUnsupportedError(f"{where}: the message is in representation {representation:#06x}")

    def skip(self, part: Part) -> None:
        """Skip one part."""
        self._count_parts(1)
        if isinstance(part, NumberPart):
            self.skip_numbers(part, 1)
        elif isinstance(part, TextPart):
            self._read_text()
        elif isinstance(part, ArrayPart):
            self.skip_elements(part.element, self.read_count(part))
        elif isinstance(part, MessagePart):
            for field in part.fields.values():
                self.skip(field)
            if not part.fields:
                self._skip_bytes(1)  # rosidl gives a structure without members one byte
        else:
            raise CdrUnsupportedError(f"{self.where}: a {part.kind} comes before it")

    def skip_numbers(self, number: NumberPart, count: int) -> int:
        """Skip `count` >= 1 numbers and the padding before them; return the offset of the first."""
        gap = -(self.at - ENCAPSULATION) % number.size
        if gap:
            self.padding[self.at] = self.at + gap
            self._skip_bytes(gap)
        return self._skip_bytes(count * number.size)

    def skip_elements(self, of: Part, count: int) -> None:
        """Skip `count` parts of one type."""
        if isinstance(of, NumberPart):
            if count:  # without numbers there is no padding
                self.skip_numbers(of, count)
        elif of.fixed:
            self._skip_uniform(of, count)
        else:
            self._skip_one_by_one(of, count)

    def read_count(self, many: ArrayPart) -> int:
        """Return the number of elements, each at least a byte long; skip the length of a sequence."""
        if many.count is not None:
            return many.count
        count = self._read_word()
        max_count = (len(self.raw) - self.at) // (many.element.size if isinstance(many.element, NumberPart) else 1)
        if count > max_count or (many.max_count is not None and count > many.max_count):
            raise self._malformed_error(f"{count} elements of a {many.kind} at byte {self.at}")
        return count

    def read_texts(self, part: Part) -> list[str]:
        """Skip an array of strings and return them."""
        count = self.read_count(part) if isinstance(part, ArrayPart) else 1
        self._count_parts(count)
        return [self._read_text().decode(errors="replace") for _ in range(count)]

    def _skip_uniform(self, of: Part, count: int) -> None:
        """Skip `count` parts of fixed length; their padding repeats, so most of them are skipped at once."""
        passed: dict[int, Span] = {}  # by alignment: parts skipped so far, and the position
        for done in range(count):
            before, position = passed.setdefault(self.at % 8, (done, self.at))
            if before < done:
                periods, rest = divmod(count - done, done - before)
                self._skip_bytes(periods * (self.at - position))
                self._skip_one_by_one(of, rest)
                return
            self.skip(of)

    def _skip_one_by_one(self, of: Part, count: int) -> None:
        for _ in range(count):
            self.skip(of)

    def _count_parts(self, count: int) -> None:
        self._parts += count
        if self._parts > MAX_PARTS:
            raise CdrUnsupportedError(f"{self.where}: more than {MAX_PARTS} parts before it")

    def _read_text(self) -> bytes:
        """Skip a string, whose last byte is its only NUL, and return it without the NUL."""
        length = self._read_word()
        start = self._skip_bytes(length)
        if length and self.raw.find(0, start, self.at) != self.at - 1:
            raise self._malformed_error(f"the string at byte {start} does not end in its only NUL")
        self.fixed.append((start, self.at))
        return self.raw[start : self.at - 1] if length else b""

    def _read_word(self) -> int:
        start = self.skip_numbers(LENGTH, 1)
        self.fixed.append((start, self.at))
        return int.from_bytes(self.raw[start : self.at], "little")

    def _skip_bytes(self, size: int) -> int:
        start, self.at = self.at, self.at + size
        if self.at > len(self.raw):
            raise self._malformed_error(f"{size} bytes are expected at byte {start}")
        return start

    def _malformed_error(self, what: str) -> SignalsError:
        return SignalsError(f"{self.where}: malformed message of {len(self.raw)} bytes: {what}")


LARGE = 4096  # bytes of a message whose names are not listed one by one if the joint's is not there at all


@dataclass(frozen=True)
class FieldLayout:
    """The place of a number in messages of `length` bytes that have the same bytes in the spans `fixed`.

    `offset` and the spans (start, end) count from the first byte of the encapsulation; `code` is the number's type in
    the module struct. `runs` are the same spans joined across the meaningless padding between them. `by_names` is the
    path with the names of elements that it takes by index, as `FieldPath.named` returns it.
    """

    length: int
    offset: int
    code: str
    fixed: tuple[Span, ...]
    runs: tuple[Span, ...]
    by_names: str = ""


def find_layout(raw: bytes, record: MessagePart, path: FieldPath) -> FieldLayout:
    """Find the number at `path` in a message of type `record`; the bytes after it are not checked.

    Raises SignalsError if the message is malformed before it or lacks the joint or element, and CdrUnsupportedError if
    the message has to be deserialised instead.
    """
    walk = Walk(raw, f"field '{path.text}'")
    part: Part = record
    spelt: list[str] = []
    for name, element in path.steps:
        if isinstance(element, str) and len(raw) > LARGE and element.encode() not in raw:
            raise SignalsError(f"{walk.where}: no joint '{element}'; the message has other names")
        if isinstance(part, MessagePart):
            part, beside = _enter(walk, part, name, element)
            spelt.append(name if element is None else f"{name}[{beside or element}]")
    if not isinstance(part, NumberPart):
        raise CdrUnsupportedError(f"field '{path.text}' is a {part.kind}")
    offset = walk.skip_numbers(part, 1)
    joined, runs = _join_spans(walk.fixed, {}), _join_spans(walk.fixed, walk.padding)
    return FieldLayout(len(raw), offset, part.code, joined, runs, path.named(spelt))


def _enter(walk: Walk, record: MessagePart, name: str, element: int | str | None) -> tuple[Part, str]:
    """Move to the start of the field `name` or of its element; return the type of that part and the element's name."""
    part = record.fields[name]
    if element is None or not isinstance(part, ArrayPart):
        _skip_fields(walk, record, name, set())
        return part, ""
    requested = {field for field in NAMES_BESIDE if _is_texts(record.fields.get(field)) and field != name}
    texts = _skip_fields(walk, record, name, requested)
    names = next((texts[field] for field in NAMES_BESIDE if texts.get(field)), [])
    if isinstance(element, str):
        if element not in names:
            raise SignalsError(f"{walk.where}: no joint '{element}'; the message has {names or 'no names'}")
        element = names.index(element)
    count = walk.read_count(part)
    if element >= count:
        raise SignalsError(f"{walk.where}: index {element} is outside an array of {count}")
    walk.skip_elements(part.element, element)
    return part.element, names[element] if element < len(names) else ""


def _is_texts(part: Part | None) -> bool:
    return isinstance(part, ArrayPart) and isinstance(part.element, TextPart)


def _skip_fields(walk: Walk, record: MessagePart, name: str, requested: set[str]) -> dict[str, list[str]]:
    """Move to the start of the field `name`; return the strings in the fields `requested`, before or after it."""
    texts: dict[str, list[str]] = {}
    start = -1
    for field, part in record.fields.items():
        start = walk.at if field == name else start
        if start >= 0 and len(texts) == len(requested):
            break
        if field in requested:
            texts[field] = walk.read_texts(part)
        else:
            walk.skip(part)
    walk.at = start
    return texts


def _join_spans(spans: Iterable[Span], padding: Mapping[int, int]) -> tuple[Span, ...]:
    """Return the spans in order, joined where they touch or have only `padding` (start to end) between them."""
    joined: list[Span] = []
    for start, end in sorted(spans):
        before = joined[-1][1] if joined else -1
        if start <= max(before, padding.get(before, before)):
            joined[-1] = (joined[-1][0], max(end, before))
        else:
            joined.append((start, end))
    return tuple(joined)
