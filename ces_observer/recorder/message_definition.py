"""The definition of a message type for readers of a bag: its .msg file and those of all types that it contains.

The format is MCAP's schema encoding `ros2msg`: the type's own text, then each contained type after a line of 80 equals
signs and a line `MSG: package/Name`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

from ces_observer.errors import SignalsError

SEPARATOR = "=" * 80
INTEGERS = (f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))
PRIMITIVES = frozenset(("bool", "byte", "char", "float32", "float64", "string", "wstring", *INTEGERS))
FIELD = re.compile(r"\s*([A-Za-z]\w*(?:/\w+)*)\S*\s+\w")  # the type, without bounds and brackets, and a name


def message_definition(type_name: str, read_msg_file: Callable[[str], str]) -> str:
    """Return the definition of `type_name`, such as sensor_msgs/msg/JointState, with all types it contains.

    `read_msg_file` returns the text of a type's .msg file; its exceptions are passed on. Raises SignalsError if a name
    is not a message type.
    """
    texts: dict[str, str] = {}
    waiting = [_full_name(type_name, "")]
    while waiting:
        name = waiting.pop(0)
        if name not in texts:
            texts[name] = read_msg_file(name)
            waiting.extend(_find_contained_types(texts[name], name.partition("/")[0]))
    parts = [f"{SEPARATOR}\nMSG: {name.replace('/msg/', '/')}\n{text}" for name, text in texts.items()]
    return "\n".join([texts[_full_name(type_name, "")], *parts[1:]])


def _find_contained_types(text: str, package: str) -> Iterator[str]:
    """Yield the full names of the message types among the fields of a .msg text."""
    for line in text.splitlines():
        field = FIELD.match(line.partition("#")[0])
        if field and field[1] not in PRIMITIVES:
            yield _full_name(field[1], package)


def _full_name(name: str, package: str) -> str:
    """Return a type's name as package/msg/Name; a name without a package belongs to `package`."""
    parts = name.split("/")
    if len(parts) == 1 and package:
        return f"{package}/msg/{name}"
    if len(parts) not in (2, 3) or (len(parts) == 3 and parts[1] != "msg") or not all(parts):
        raise SignalsError(f"'{name}' is not a message type; expected package/msg/Name")
    return f"{parts[0]}/msg/{parts[-1]}"
