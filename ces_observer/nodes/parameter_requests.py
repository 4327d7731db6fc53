"""Limits on requests to a node's parameter services, which rclpy answers itself in the thread of the samples.

Requests and responses come in as objects with the fields of rcl_interfaces' services; this module does not use ROS.
"""

from __future__ import annotations

from typing import Any

MAX_NAMES = 500  # names, prefixes or parameters in one request
MAX_NAME_LENGTH = 1000  # characters
MAX_VALUE_LENGTH = 10_000  # characters of a string, elements of an array
LISTS = ("names", "prefixes", "parameters")
VALUES = (
    "string_value",
    "byte_array_value",
    "bool_array_value",
    "integer_array_value",
    "double_array_value",
    "string_array_value",
)


def find_excess(request: Any) -> str:
    """Return in what a request exceeds the limits, empty if in nothing."""
    for name in LISTS:
        found = getattr(request, name, ())
        if len(found) > MAX_NAMES:
            return f"{len(found)} {name} in one request; expected at most {MAX_NAMES}"
        for one in found:
            excess = _find_excess_of(one)
            if excess:
                return excess
    return ""


def _find_excess_of(one: Any) -> str:
    """Return in what one name or parameter exceeds the limits."""
    name = one if isinstance(one, str) else one.name
    if len(name) > MAX_NAME_LENGTH:
        return f"a parameter's name of {len(name)} characters; expected at most {MAX_NAME_LENGTH}"
    if isinstance(one, str):
        return ""
    longest = max(len(getattr(one.value, field)) for field in VALUES)
    if longest > MAX_VALUE_LENGTH:
        return f"parameter '{name}' has {longest} characters or elements; expected at most {MAX_VALUE_LENGTH}"
    if any(len(text) > MAX_VALUE_LENGTH for text in one.value.string_array_value):
        return f"parameter '{name}' has a string of more than {MAX_VALUE_LENGTH} characters; expected fewer"
    return ""
