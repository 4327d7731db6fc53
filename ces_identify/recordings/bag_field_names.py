"""The numbers in a message, as field paths in the spelling of ROS 2: `wrench.force.z`, `position[rear_damper]`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc
from rosbags.typesys.store import Typestore

from ces_identify.recordings.bag_message import JOINT_NAMES

TEXTS = ("string", "wstring")
HEADER = "std_msgs/msg/Header"
MAX_FIELDS_LISTED = 20


def format_fields(message: object, typename: str, typestore: Typestore) -> str:
    """Return the field paths of a message's numbers as text."""
    paths = list(list_number_fields(message, typename, typestore))
    more = [f"{len(paths) - MAX_FIELDS_LISTED} more"] if len(paths) > MAX_FIELDS_LISTED else []
    return f"{typename} has {', '.join(paths[:MAX_FIELDS_LISTED] + more) or 'no numbers'}"


def spell_as_ros(text: str) -> str:
    """Return a text with the names of Python's types as ROS 2 spells them."""
    return re.sub(r"\b(\w+)__msg__(\w+)\b", r"\1/msg/\2", text).replace("a ndarray", "an array")


def list_number_fields(message: Any, typename: str, typestore: Typestore, before: str = "") -> Iterator[str]:
    """Yield the field path of each number in a message, without headers; arrays by joint name, or with their first
    index.
    """
    joints = next((list(names) for key in JOINT_NAMES if (names := getattr(message, key, None))), [])
    for name, description in typestore.get_msgdef(typename).fields:
        yield from _list_field(getattr(message, name), description, typestore, before + name, joints)


def _list_field(
    value: Any, description: FieldDesc, typestore: Typestore, path: str, joints: list[str]
) -> Iterator[str]:
    match description:
        case (Nodetype.BASE, (kind, _)):
            if kind not in TEXTS:
                yield path
        case (Nodetype.NAME, typename):
            if typename != HEADER:
                yield from list_number_fields(value, str(typename), typestore, f"{path}.")
        case (_, (inner, _)) if len(value):
            elements = joints if len(joints) == len(value) else [0]
            for element in elements:
                yield from _list_field(value[0], inner, typestore, f"{path}[{element}]", [])
