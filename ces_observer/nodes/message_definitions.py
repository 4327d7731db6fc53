"""The channel of a bag for a topic, with its message type's definition and hash from the installation."""

from __future__ import annotations

import json
from pathlib import Path

from rosidl_runtime_py import get_interface_path

from ces_observer.recorder.mcap_file import BagChannel
from ces_observer.recorder.message_definition import message_definition


def bag_channel(topic: str, type_name: str) -> BagChannel:
    """Return the channel of a bag for `topic`; raises LookupError or OSError if the type's text is not installed."""
    return BagChannel(topic, type_name, message_definition(type_name, _text), _hash(type_name))


def _text(type_name: str) -> str:
    return Path(get_interface_path(type_name)).read_text(encoding="utf-8")


def _hash(type_name: str) -> str:
    """Return the type's RIHS01 hash, empty if it is not installed."""
    try:
        described = json.loads(Path(get_interface_path(type_name)).with_suffix(".json").read_text(encoding="utf-8"))
        return next(str(one["hash_string"]) for one in described["type_hashes"] if one["type_name"] == type_name)
    except (OSError, ValueError, LookupError, StopIteration):
        return ""
