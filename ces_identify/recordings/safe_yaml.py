"""YAML files that users write, read with care: safe types only, limited size and depth, no aliases, no repeated keys.

Every mistake is raised as the CesError subclass that the caller names, in one line with the file and, if it can, the
line.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from ces_observer.errors import CesError

SIZE_LIMIT = 65_536
DEPTH_LIMIT = 20
# What PyYAML raises at scalars that are not what their tag says: its own errors, and those of what it converts with.
UNREADABLE = (yaml.YAMLError, ValueError, TypeError, LookupError, ArithmeticError, AttributeError)


def load_mapping(path: Path, kind: type[CesError], expected: str) -> dict[str, Any]:
    """Return the mapping in a file; `expected` says in an error what should have been there."""
    found: dict[str, Any] = plain(compose(path, kind, expected), path, kind)
    return found


def compose(path: Path, kind: type[CesError], expected: str) -> yaml.MappingNode:
    """Return the mapping in a file as a tree of nodes, which know their lines."""
    text = _read(path, kind, expected)
    try:
        _refuse_growth(text, path, kind)
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        line = f":{error.problem_mark.line + 1}" if error.problem_mark else ""
        raise kind(f"{path}{line}: not valid YAML: {error.problem or error.context}") from None
    except UNREADABLE as error:
        raise kind(f"{path}: not valid YAML: {_first_line(error)}") from None
    if not isinstance(root, yaml.MappingNode):
        raise kind(f"{path}: is not a mapping; expected {expected}")
    _refuse_repeats(root, path, kind)
    return root


def plain(node: yaml.Node, path: Path, kind: type[CesError]) -> Any:
    """Return the value of a node as numbers, text, lists and dictionaries."""
    loader = yaml.SafeLoader("")
    try:
        return loader.construct_object(node, deep=True)
    except UNREADABLE as error:
        raise kind(f"{place(path, node)}: not valid YAML: {_first_line(error)}") from None
    finally:
        loader.dispose()


def place(path: Path, where: yaml.Node | yaml.Event) -> str:
    """Return `file:line` of a node."""
    return f"{path}:{where.start_mark.line + 1}" if where.start_mark else str(path)


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def _read(path: Path, kind: type[CesError], expected: str) -> str:
    try:
        with path.open("rb") as file:
            raw = file.read(SIZE_LIMIT + 1)
        if len(raw) > SIZE_LIMIT:
            raise kind(f"{path}: larger than {SIZE_LIMIT} bytes; expected {expected}")
        return raw.decode("utf-8")
    except OSError as error:
        raise kind(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise kind(f"{path}: is not UTF-8 text; expected {expected}") from None


def _refuse_growth(text: str, path: Path, kind: type[CesError]) -> None:
    """Raise at an alias or at deep nesting, before either costs memory or time."""
    depth = 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if isinstance(event, yaml.AliasEvent):
            raise kind(f"{place(path, event)}: alias '*{event.anchor}'; write the value out")
        if depth > DEPTH_LIMIT:
            raise kind(f"{place(path, event)}: nested more than {DEPTH_LIMIT} deep; remove some levels")


def _refuse_repeats(node: yaml.Node, path: Path, kind: type[CesError]) -> None:
    """Raise where a mapping has the same key twice, of which YAML would silently take the last."""
    if isinstance(node, yaml.MappingNode):
        known: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise kind(f"{place(path, key)}: a key is a list or a mapping; expected a name")
            if key.value in known:
                raise kind(f"{place(path, key)}: {key.value[:60]!r} is given twice; keep one")
            known.add(key.value)
    for child in node.value if isinstance(node, yaml.CollectionNode) else []:
        _refuse_repeats(child[1] if isinstance(child, tuple) else child, path, kind)
