"""Message types by name: a signal in, its message class, checked to have the signal's field, out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rosidl_runtime_py.utilities import get_message

from ces_observer.errors import SignalsError
from ces_observer.signals import Signal


def message_class(signal: Signal) -> Any:
    """Return the class of the signal's message type; raises SignalsError if it or the field is missing."""
    try:
        kind = get_message(signal.type)
        _check_field(signal, kind())
    except (ImportError, AttributeError, ValueError):
        raise SignalsError(
            f"signal '{signal.name}': message type '{signal.type}' is not installed; check {signal.name}.type, or "
            "source the workspace that has it"
        ) from None
    return kind


def fields_of(type_name: str) -> Mapping[str, str]:
    """Return the fields of a type (`package/Type` or `package/msg/Type`) with their types in rosidl's notation.

    Raises LookupError if the type is not installed.
    """
    package, *_, name = type_name.split("/")
    try:
        fields: Mapping[str, str] = get_message(f"{package}/msg/{name}").get_fields_and_field_types()
    except (ImportError, AttributeError, ValueError):
        raise LookupError(f"message type '{type_name}' is not installed") from None
    return fields


def is_stamped(kind: Any) -> bool:
    """Return whether messages of this class have a std_msgs/Header."""
    return bool(kind.get_fields_and_field_types().get("header") == "std_msgs/Header")


def header_stamp_ns(message: Any) -> int:
    """Return the header stamp of a stamped message [ns]."""
    stamp = message.header.stamp
    return int(stamp.sec * 1_000_000_000 + stamp.nanosec)


def _check_field(signal: Signal, message: Any) -> None:
    """Check the field path in an empty message, up to the first array."""
    where = f"signal '{signal.name}': field '{signal.field.text}' of {signal.type}"
    value = message
    for name, element in signal.field.steps:
        fields = value.get_fields_and_field_types() if hasattr(value, "get_fields_and_field_types") else {}
        if name not in fields:
            raise SignalsError(f"{where}: no '{name}'; known are {', '.join(fields) or 'no fields'}")
        value = getattr(value, name)
        if element is not None:
            if isinstance(value, str) or not hasattr(value, "__len__"):
                raise SignalsError(f"{where}: '{name}' is not an array; omit [{element}]")
            return
    if not isinstance(value, int | float):
        raise SignalsError(f"{where} is a {type(value).__name__}; expected the path to a number")
