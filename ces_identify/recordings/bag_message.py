"""A blank message of any type that holds the requested numbers: long enough arrays, named joints, all else zero."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import BaseDesc, FieldDesc, NameDesc
from rosbags.typesys.store import Typestore

from ces_observer.errors import SignalsError
from ces_observer.signals import FieldPath

JOINT_NAMES = ("name", "joint_names")
Place = tuple[str | int, ...]


def blank_message(typename: str, paths: Sequence[FieldPath], typestore: Typestore) -> object:
    """Return a message of type `typename` in which every path can be read.

    Raises SignalsError if a path names a joint in a message without joint names.
    """
    room = _Room(typestore)
    for path in paths:
        room.reserve(typename, path)
    return room.message(typename, ())


class _Room:
    """Lengths of the arrays and names of the joints that the paths need, by place in the message."""

    def __init__(self, typestore: Typestore) -> None:
        self.typestore = typestore
        self.lengths: dict[Place, int] = {}
        self.joints: dict[Place, list[str]] = {}

    def reserve(self, typename: str, path: FieldPath) -> None:
        place: Place = ()
        for name, element in path.steps:
            parent, place = place, (*place, name)
            if element is not None:
                index = element if isinstance(element, int) else self._joint(typename, parent, path, element)
                self.lengths[place] = max(self.lengths.get(place, 0), index + 1)
                place = (*place, index)

    def _joint(self, typename: str, parent: Place, path: FieldPath, joint: str) -> int:
        """Return the index of a joint, after adding its name to the message's joint names."""
        holder = self._type_at(typename, parent)
        field = next((name for name, _ in self._fields(holder) if name in JOINT_NAMES), None)
        if field is None:
            raise SignalsError(f"field '{path.text}': {holder} has no joint names; give the index instead of '{joint}'")
        names = self.joints.setdefault((*parent, field), [])
        if joint not in names:
            names.append(joint)
        return names.index(joint)

    def _type_at(self, typename: str, place: Place) -> str:
        for step in place:
            if isinstance(step, str):
                description = dict(self._fields(typename)).get(step)
                if description is not None and description[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                    description = description[1][0]
                typename = description[1] if description and description[0] == Nodetype.NAME else typename
        return typename

    def _fields(self, typename: str) -> list[tuple[str, FieldDesc]]:
        return self.typestore.get_msgdef(typename).fields

    def message(self, typename: str, place: Place) -> object:
        """Build the message at `place`."""
        values = {name: self._value(description, (*place, name)) for name, description in self._fields(typename)}
        return self.typestore.types[typename](**values)

    def _value(self, description: FieldDesc, place: Place) -> Any:
        if description[0] == Nodetype.BASE:
            return {"string": "", "bool": False}.get(description[1][0], 0)
        if description[0] == Nodetype.NAME:
            return self.message(description[1], place)
        if place in self.joints:
            return list(self.joints[place])
        element, size = description[1]
        return self._array(element, size if description[0] == Nodetype.ARRAY else self.lengths.get(place, 0), place)

    def _array(self, element: BaseDesc | NameDesc, length: int, place: Place) -> Any:
        if element[0] == Nodetype.NAME:
            return [self.message(element[1], (*place, i)) for i in range(length)]
        if element[1][0] == "string":
            return [""] * length
        return np.zeros(length, dtype={"byte": "int8", "char": "uint8"}.get(element[1][0], element[1][0]))
