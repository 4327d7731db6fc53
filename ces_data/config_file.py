"""Reads YAML files that users write: safe types only, limited size and depth, no aliases, no repeated keys.

Every mistake raises the caller's CesError subclass with one line: the file and, if known, the line, what is wrong, and
what was expected.
"""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml

from ces_observer.errors import CesError

MAX_BYTES = 65_536
MAX_DEPTH = 20
# PyYAML's errors at scalars that do not match their tag: its own, and those of the conversions.
UNREADABLE = (yaml.YAMLError, ValueError, TypeError, LookupError, ArithmeticError, AttributeError)


class _Loader(yaml.SafeLoader):
    """Reads 1e-3 as a number, as ROS 2 and YAML 1.2 do; PyYAML itself wants 1.0e-3."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\.\d+|\d+(\.\d*)?)[eE][-+]?\d+\Z"), list("-+.0123456789")
)


def packaged_text(package: str, name: str) -> str:
    """Return the text of a YAML file in a package, without its first line, which names the schema there."""
    return (files(package) / name).read_text(encoding="utf-8").partition("\n")[2]


def read_yaml_mapping(path: Path, what: str, error: type[CesError] = CesError) -> dict[str, Any]:
    """Return the mapping in a file, which errors describe as `what`."""
    return parse_yaml_mapping(_read_text(path, what, error), str(path), what, error)


def parse_yaml_mapping(text: str, source: str, what: str, error: type[CesError] = CesError) -> dict[str, Any]:
    """Return the mapping in a text, as `read_yaml_mapping` does; `source` begins each error."""
    content: dict[str, Any] = to_python(_parse_tree(text, source, what, error), source, error)
    return content


def read_yaml_tree(path: Path, what: str, error: type[CesError] = CesError) -> yaml.MappingNode:
    """Return the mapping in a file as a tree of nodes with their lines; `to_python` returns their values."""
    return _parse_tree(_read_text(path, what, error), str(path), what, error)


def to_python(node: yaml.Node, source: Path | str, error: type[CesError] = CesError) -> Any:
    """Return the value of a node as numbers, text, lists and dictionaries."""
    loader = yaml.SafeLoader("")
    try:
        return loader.construct_object(node, deep=True)
    except UNREADABLE as reason:
        raise error(f"{_place(source, node)}: not valid YAML: {first_line(reason)}") from None
    finally:
        loader.dispose()


def _read_text(path: Path, what: str, error: type[CesError]) -> str:
    try:
        with path.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
        if len(raw) > MAX_BYTES:
            raise error(f"{path}: larger than {MAX_BYTES} bytes; expected {what}")
        return raw.decode("utf-8")
    except OSError as reason:
        raise error(f"{path}: cannot be read: {reason.strerror}; expected {what}") from None
    except UnicodeDecodeError:
        raise error(f"{path}: is not UTF-8 text; expected {what}") from None


def _parse_tree(text: str, source: str, what: str, error: type[CesError]) -> yaml.MappingNode:
    try:
        depth = 0
        for event in yaml.parse(text, Loader=yaml.SafeLoader):  # before aliases or depth cost memory or time
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if isinstance(event, yaml.AliasEvent):
                raise error(f"{_place(source, event)}: alias '*{event.anchor}'; write the value out")
            if depth > MAX_DEPTH:
                raise error(f"{_place(source, event)}: nested more than {MAX_DEPTH} deep; remove some levels")
        root = yaml.compose(text, Loader=_Loader)
    except yaml.MarkedYAMLError as reason:
        line = f":{reason.problem_mark.line + 1}" if reason.problem_mark else ""
        raise error(f"{source}{line}: not valid YAML: {reason.problem or reason.context}") from None
    except UNREADABLE as reason:
        raise error(f"{source}: not valid YAML: {first_line(reason)}") from None
    if not isinstance(root, yaml.MappingNode):
        raise error(f"{source}: is not a mapping; expected {what}")
    _refuse_repeats(root, source, error)
    return root


def _refuse_repeats(node: yaml.Node, source: str, error: type[CesError]) -> None:
    """Raise at a repeated key, of which YAML would silently use the last."""
    if isinstance(node, yaml.MappingNode):
        keys: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise error(f"{_place(source, key)}: a key is a list or a mapping; expected a name")
            if key.value in keys:
                raise error(f"{_place(source, key)}: {key.value[:60]!r} is given twice; keep one")
            keys.add(key.value)
    for child in node.value if isinstance(node, yaml.CollectionNode) else []:
        _refuse_repeats(child[1] if isinstance(child, tuple) else child, source, error)


def _place(source: Path | str, where: yaml.Node | yaml.Event) -> str:
    """Return `file:line` of a node."""
    return f"{source}:{where.start_mark.line + 1}" if where.start_mark else str(source)


def first_line(reason: Exception) -> str:
    """Return the first line of an error's text, or its type if it has none."""
    return (str(reason).strip().splitlines() or [type(reason).__name__])[0]
