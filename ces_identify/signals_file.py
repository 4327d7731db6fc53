"""Signals description files: YAML in ROS 2 parameter-file form in, `Signals` out; the node reads the same file.

Aliases are refused, as the parameter parser of ROS 2 refuses them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ces_identify.safe_yaml import compose, plain
from ces_observer.errors import SignalsError
from ces_observer.signals import NAMES, Signals

KEYS = frozenset({"topic", "type", "field", "scale", "offset", "constant"})


@dataclass(frozen=True)
class _Description:
    """What one section of the file says about one signal, and in which line."""

    section: str
    line: int
    value: Any

    @property
    def exact(self) -> bool:
        """True if the section is for one node by name, not for all that match a wildcard."""
        return "*" not in self.section


def load_signals(path: Path | None = None) -> Signals:
    """Read a signals description; the defaults if `path` is None.

    Accepted are parameter files with any node names, namespaces and wildcards (what a named node has overrides what a
    wildcard gives it) and a plain mapping of signals. Raises SignalsError naming the file and, if it can, the line.
    """
    if path is None:
        return Signals.from_mapping({}, "defaults")
    root = compose(path, SignalsError, "a signals description, '/**: ros__parameters: position: ...'")
    found = _descriptions(root, path)
    if not found:
        raise SignalsError(f"{path}: describes no signal; expected at least one of {', '.join(NAMES)} with its topic")
    merged = {name: _merge(name, parts, path) for name, parts in found.items()}
    return Signals.from_mapping(merged, str(path))


def _descriptions(root: yaml.MappingNode, path: Path) -> dict[str, list[_Description]]:
    """Return by signal what each section says about it, wildcard sections first."""
    found: dict[str, list[_Description]] = {}
    sections = list(_sections(root, "")) or [("/**", root)]
    for section, parameters in sorted(sections, key=lambda item: "*" not in item[0]):
        for key, value in parameters.value:
            name, dot, rest = str(key.value).partition(".")
            if name not in NAMES:
                continue
            content = {rest: plain(value, path, SignalsError)} if dot else plain(value, path, SignalsError)
            if _is_signal(content, sections):
                found.setdefault(name, []).append(_Description(section, key.start_mark.line + 1, content))
    return found


def _sections(node: yaml.MappingNode, name: str) -> Iterator[tuple[str, yaml.MappingNode]]:
    for key, value in node.value:
        if isinstance(value, yaml.MappingNode):
            if key.value == "ros__parameters":
                yield name, value
            else:
                yield from _sections(value, f"{name}/{str(key.value).strip('/')}")


def _is_signal(content: object, sections: list[tuple[str, yaml.MappingNode]]) -> bool:
    """Tell a signal from another node's parameter of the same name, which only a file of several sections can have."""
    return len(sections) == 1 or (isinstance(content, Mapping) and not KEYS.isdisjoint(content))


def _merge(name: str, parts: list[_Description], path: Path) -> Any:
    """Return one mapping for the signal, checked alone so that an error can name its line."""
    exact = {part.section: part.line for part in parts if part.exact}
    if len(exact) > 1:
        places = " and ".join(f"'{section}' (line {line})" for section, line in exact.items())
        raise SignalsError(f"{path}: signal '{name}' is described for {places}; expected one node's signals in a file")
    merged: Any = {}
    for part in parts:
        merged = {**merged, **part.value} if isinstance(part.value, Mapping) else part.value
    _check(name, merged, f"{path}:{parts[-1].line}")
    return merged


def _check(name: str, content: Any, where: str) -> None:
    try:
        Signals.from_mapping({name: content}, where)
    except SignalsError as error:
        raise SignalsError(str(error) if where in str(error) else f"{where}: signal '{name}': {error}") from None
