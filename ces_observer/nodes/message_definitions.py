"""The text that describes a message type in a bag, as `ros2 bag` writes it: its definition and those it is made of."""

from __future__ import annotations

import json
from pathlib import Path

from rosidl_runtime_py import get_interface_path

from ces_observer.nodes.message_types import fields_of
from ces_observer.recorder.mcap_file import BagChannel

LINE = "=" * 80
NUMBER_OR_TEXT = "/"  # the type of a field that is itself a message has a slash


def bag_channel(topic: str, type_name: str) -> BagChannel:
    """Return the channel of a bag for `topic`; raises LookupError or OSError if the type is not installed as text."""
    first, *others = _with_parts(type_name, [])
    text = "\n".join([_text(first), *(f"{LINE}\nMSG: {_short(other)}\n{_text(other)}" for other in others)])
    return BagChannel(topic, type_name, text, _hash(type_name))


def _with_parts(type_name: str, found: list[str]) -> list[str]:
    """Return a type and, depth first, each type it is made of."""
    if type_name not in found:
        found.append(type_name)
        for kind in fields_of(type_name).values():
            element = kind.removeprefix("sequence<").partition("[")[0].partition(",")[0].rstrip(">")
            if NUMBER_OR_TEXT in element:
                package, _, name = element.partition("/")
                _with_parts(f"{package}/msg/{name}", found)
    return found


def _text(type_name: str) -> str:
    return Path(get_interface_path(type_name)).read_text(encoding="utf-8")


def _short(type_name: str) -> str:
    return type_name.replace("/msg/", "/")


def _hash(type_name: str) -> str:
    """Return the type's RIHS01 hash, empty if this installation has none."""
    try:
        described = json.loads(Path(get_interface_path(type_name)).with_suffix(".json").read_text(encoding="utf-8"))
        return next(str(one["hash_string"]) for one in described["type_hashes"] if one["type_name"] == type_name)
    except (OSError, ValueError, LookupError, StopIteration):
        return ""
