"""The parts of messages: rosidl's type strings in, the tree that `ces_observer.cdr.layout` follows out.

The strings are those of `get_fields_and_field_types()`: `double`, `string<10>`, `double[9]`, `sequence<double>`,
`sequence<geometry_msgs/Pose, 5>`, `std_msgs/Header`.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from ces_observer.errors import SignalsError
from ces_observer.signals import FieldPath

FieldsOf = Callable[[str], Mapping[str, str]]  # raises LookupError for an unknown type
JOINT_NAMES = ("name", "joint_names")  # in the order in which FieldPath looks for them
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
        names = [parent.fields[field] for field in JOINT_NAMES if field in parent.fields]
        if not names:
            raise SignalsError(f"field '{path.text}': no joint '{element}'; the message has no names")
        if not all(isinstance(part, ArrayPart) and isinstance(part.element, TextPart) for part in names):
            raise CdrUnsupportedError(f"field '{path.text}': the joints of {parent.kind} are not named by strings")
    return array.element
