"""The layout of a serialised message, found by walking along its bytes with the type's definition.

A raw message (CDR, either byte order) goes in; a `MessageLayout` comes out, with the offsets of the requested numbers
and the bytes that determine them. The result is checked against the values that rosbags reads from the same message.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import BaseDesc, FieldDesc, NameDesc
from rosbags.typesys.store import Typestore

from ces_identify.recordings.bag_message import JOINT_NAMES, Place
from ces_identify.recordings.bulk_decode import MessageLayout, NumberField
from ces_observer.errors import SignalsError
from ces_observer.signals import FieldPath

ENCAPSULATION = 4  # bytes before the message: representation (2) and options (2)
KINDS = {
    "bool": "?",
    "byte": "i1",
    "char": "u1",
    **{f"{sign}int{8 * size}": f"{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4, 8)},
    "float32": "f4",
    "float64": "f8",
}


class NotWalkableError(Exception):
    """The message has a part of unknown size."""


def describe_layout(
    raw: bytes, typename: str, paths: Sequence[FieldPath], typestore: Typestore
) -> MessageLayout | None:
    """Return the layout of a message, None if it cannot be found or disagrees with rosbags.

    Raises rosbags' SerdeError if the message cannot be read.
    """
    message = typestore.deserialize_cdr(raw, typename)
    walk = _Walk(raw, typestore)
    try:
        walk.message(typename, ())
        numbers = tuple(walk.find(message, path) for path in paths)
    except NotWalkableError:
        return None
    if not walk.position <= len(raw) < walk.position + 4:
        return None
    if not all(_agrees(number, raw, path, message) for number, path in zip(numbers, paths, strict=True)):
        return None
    fixed = np.unique(np.array(walk.fixed, dtype=np.int64))
    return MessageLayout(fixed, np.frombuffer(raw, dtype=np.uint8)[fixed], numbers)


class _Walk:
    """A position in the bytes of one message, and the numbers and strings before it."""

    def __init__(self, raw: bytes, typestore: Typestore) -> None:
        self.raw = raw
        self.typestore = typestore
        self.order = "<" if raw[1] else ">"
        self.position = ENCAPSULATION
        self.fixed = [0, 1]
        self.numbers: dict[Place, NumberField] = {}
        self.texts: dict[Place, list[int]] = {}

    def message(self, typename: str, place: Place) -> None:
        for name, description in self.typestore.get_msgdef(typename).fields:
            self._field(description, (*place, name))

    def find(self, message: object, path: FieldPath) -> NumberField | str:
        """Return the number's offset, or why the message has none; joint names in `path` become fixed bytes."""
        place: Place = ()
        for name, element in path.steps:
            if isinstance(element, str):
                for names in JOINT_NAMES:
                    self.fixed.extend(self.texts.get((*place, names), ()))
            place = (*place, name) if element is None else (*place, name, element)
        try:
            path.read(message)
            return self._number(_place(message, path))
        except SignalsError as error:
            return str(error)

    def _number(self, place: Place) -> NumberField:
        *parent, last = place
        if isinstance(last, int):
            place = tuple(parent)
        if place not in self.numbers:
            raise NotWalkableError(place)
        first = self.numbers[place]
        return NumberField(first.offset + (last * first.dtype.itemsize if isinstance(last, int) else 0), first.dtype)

    def _field(self, description: FieldDesc, place: Place) -> None:
        if description[0] == Nodetype.BASE:
            self._elements(description, 1, place)
        elif description[0] == Nodetype.NAME:
            self.message(description[1], place)
        elif description[0] == Nodetype.ARRAY:
            self._elements(description[1][0], description[1][1], place)
        else:
            self._elements(description[1][0], self._length_word(), place)

    def _elements(self, description: BaseDesc | NameDesc, count: int, place: Place) -> None:
        if description[0] == Nodetype.NAME:
            for i in range(count):
                self.message(description[1], (*place, i))
        elif description[1][0] == "string":
            for _ in range(count):
                self._text(place)
        else:
            self._array(description[1][0], count, place)

    def _array(self, kind: str, count: int, place: Place) -> None:
        """Pass `count` numbers; without any there is no padding either."""
        if kind not in KINDS:
            raise NotWalkableError(kind)
        dtype = np.dtype(self.order + KINDS[kind])
        if count:
            self._align(dtype.itemsize)
            self.numbers[place] = NumberField(self.position, dtype)
            self.position += count * dtype.itemsize

    def _text(self, place: Place) -> None:
        """Pass a string: its length and terminator are fixed, its letters only if they name a joint in a path."""
        length = self._length_word()
        self.texts.setdefault(place, []).extend(range(self.position, self.position + length))
        self.position += length
        self.fixed.append(self.position - 1)

    def _length_word(self) -> int:
        self._align(4)
        self.fixed.extend(range(self.position, self.position + 4))
        self.position += 4
        return int.from_bytes(self.raw[self.position - 4 : self.position], "little" if self.order == "<" else "big")

    def _align(self, size: int) -> None:
        self.position += -(self.position - ENCAPSULATION) % size


def _place(message: object, path: FieldPath) -> Place:
    """Return the path with joint names replaced by indices; `path.read(message)` must have succeeded."""
    place: Place = ()
    value: Any = message
    for name, element in path.steps:
        parent, value = value, getattr(value, name)
        place = (*place, name)
        if element is not None:
            names: Any = getattr(parent, "name", None) or getattr(parent, "joint_names", ())
            index = element if isinstance(element, int) else list(names).index(element)
            place, value = (*place, index), value[index]
    return place


def _agrees(number: NumberField | str, raw: bytes, path: FieldPath, message: object) -> bool:
    """Compare the number at the offset with the one that rosbags reads."""
    if isinstance(number, str):
        return True
    value = number.read(np.frombuffer(raw, dtype=np.uint8), np.zeros(1, dtype=np.int64))[0]
    return bool(np.array_equal(value, path.read(message), equal_nan=True))
