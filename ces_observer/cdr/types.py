"""The parts messages are made of: rosidl's type strings in, a small tree out that a walk along CDR bytes can follow.

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

FieldsOf = Callable[[str], Mapping[str, str]]  # raises LookupError for a type that is not known
JOINT_NAMES = ("name", "joint_names")  # in the order in which FieldPath asks for them
CODES = {
    "boolean": "?",
    "octet": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float": "f",
    "double": "d",
}

_SEQUENCE = re.compile(r"sequence<(.+?)(?:, (\d+))?>")
_ARRAY = re.compile(r"(.+)\[(\d+)\]")
_TEXT = re.compile(r"string(<\d+>)?")


class CdrUnsupportedError(Exception):
    """A message that is read the ordinary way, by deserialising it: nothing is wrong with it as far as is known."""


@dataclass(frozen=True)
class Number:
    """One number; `code` is that of the module struct."""

    kind: str
    code: str
    fixed = True  # takes the same bytes in every message, but for the padding before it

    @property
    def size(self) -> int:
        """Number of bytes, and alignment."""
        return struct.calcsize(f"<{self.code}")


@dataclass(frozen=True)
class Text:
    """A string of 8-bit characters."""

    kind: str
    fixed = False


@dataclass(frozen=True)
class Opaque:
    """What cannot be walked over: wstring, long double, a type that is not installed."""

    kind: str
    fixed = False


@dataclass(frozen=True)
class Many:
    """An array of `count` elements, or a sequence if that is None, of at most `most` if that is not None."""

    kind: str
    of: Part
    count: int | None
    most: int | None = None

    @property
    def fixed(self) -> bool:
        """True if it takes the same bytes in every message."""
        return self.count is not None and self.of.fixed


@dataclass(frozen=True)
class Record:
    """A message within a message, or the whole one."""

    kind: str
    fields: Mapping[str, Part]

    @property
    def fixed(self) -> bool:
        """True if it takes the same bytes in every message."""
        return all(part.fixed for part in self.fields.values())


Part = Number | Text | Opaque | Many | Record


def record_of(type_name: str, fields_of: FieldsOf) -> Record:
    """Return the tree of a message type; raises CdrUnsupportedError if the type is not known."""
    record = part_of(type_name, fields_of)
    if not isinstance(record, Record):
        raise CdrUnsupportedError(f"the fields of '{type_name}' are not known")
    return record


def part_of(kind: str, fields_of: FieldsOf) -> Part:
    """Return the tree of a type string."""
    if sequence := _SEQUENCE.fullmatch(kind):
        return Many(kind, part_of(sequence[1], fields_of), None, int(sequence[2]) if sequence[2] else None)
    if array := _ARRAY.fullmatch(kind):
        return Many(kind, part_of(array[1], fields_of), int(array[2]))
    if kind in CODES:
        return Number(kind, CODES[kind])
    if _TEXT.fullmatch(kind):
        return Text(kind)
    try:
        return Record(kind, {name: part_of(of, fields_of) for name, of in fields_of(kind).items()})
    except LookupError:
        return Opaque(kind)


def number_at(record: Record, path: FieldPath) -> Number:
    """Return the kind of number at `path`.

    Raises SignalsError, as `path.read` does, if messages of this type hold no number there, and CdrUnsupportedError
    if they may hold one that `path.read` makes of something else, such as a string.
    """
    part: Part = record
    for name, element in path.steps:
        if not isinstance(part, Record) or name not in part.fields:
            raise SignalsError(f"field '{path.text}': no '{name}' in {part.kind.rpartition('/')[2]}")
        parent, part = part, part.fields[name]
        if element is not None:
            part = _element(parent, part, path, element)
    if isinstance(part, Many | Record):
        raise SignalsError(f"field '{path.text}' is a {part.kind}, not a number")
    if not isinstance(part, Number) or part.kind == "octet":
        raise CdrUnsupportedError(f"field '{path.text}' is a {part.kind}")
    return part


def _element(parent: Record, array: Part, path: FieldPath, element: int | str) -> Part:
    if not isinstance(array, Many):
        raise CdrUnsupportedError(f"field '{path.text}': [{element}] of a {array.kind}")
    if isinstance(element, str):
        names = [parent.fields[field] for field in JOINT_NAMES if field in parent.fields]
        if not names:
            raise SignalsError(f"field '{path.text}': no joint '{element}'; the message has no names")
        if not all(isinstance(part, Many) and isinstance(part.of, Text) for part in names):
            raise CdrUnsupportedError(f"field '{path.text}': the joints of {parent.kind} are not named by strings")
    return array.of
