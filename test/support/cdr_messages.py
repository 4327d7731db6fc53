"""Messages serialised by rosbags, and its type definitions in rosidl's notation."""

from __future__ import annotations

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types
KINDS = {"bool": "boolean", "byte": "octet", "char": "uint8", "float32": "float", "float64": "double"}


def define(name, text):
    """Make a message type of one's own known."""
    STORE.register(get_types_from_msg(text, name))


def fields_of(type_name):
    """Return the type strings of the fields, as `get_fields_and_field_types()` does; KeyError if it is not known."""
    package, *_, kind = type_name.split("/")
    fields = STORE.fielddefs[f"{package}/msg/{kind}"][1]
    return {name: notation(of) for name, of in fields if name != "structure_needs_at_least_one_member"}


def notation(description):
    kind, of = description
    if kind == Nodetype.NAME:
        return of.replace("/msg/", "/")
    if kind == Nodetype.BASE:
        return KINDS.get(of[0], of[0]) + (f"<{of[1]}>" if of[1] else "")
    element, size = of
    if kind == Nodetype.ARRAY:
        return f"{notation(element)}[{size}]"
    return f"sequence<{notation(element)}{f', {size}' if size else ''}>"


def message(kind, **fields):
    """Build a message of type package/Type: fields that are not given are zero or empty."""
    package, name = kind.split("/")
    definition = STORE.fielddefs[f"{package}/msg/{name}"][1]
    values = {field: _value(of, fields.pop(field)) if field in fields else _blank(of) for field, of in definition}
    assert not fields, f"{kind} has no {fields}"
    return TYPES[f"{package}/msg/{name}"](**values)


def _blank(description):
    kind, of = description
    if kind == Nodetype.NAME:
        return message(of.replace("/msg/", "/"))
    if kind == Nodetype.BASE:
        return {"string": "", "bool": False}.get(of[0], 0)
    return _value(description, [] if kind == Nodetype.SEQUENCE else [_blank(of[0]) for _ in range(of[1])])


def _value(description, value):
    """Return `value` as rosbags wants it: numbers in arrays of their type."""
    kind, of = description
    if kind in (Nodetype.BASE, Nodetype.NAME) or of[0][0] == Nodetype.NAME or of[0][1][0] == "string":
        return value
    return np.array(value, dtype={"byte": "uint8", "char": "uint8"}.get(of[0][1][0], of[0][1][0]))


def header(stamp_ns, frame_id=""):
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    stamp = message("builtin_interfaces/Time", sec=sec, nanosec=nanosec)
    return message("std_msgs/Header", stamp=stamp, frame_id=frame_id)


def serialised(built):
    return bytes(STORE.serialize_cdr(built, built.__msgtype__))
