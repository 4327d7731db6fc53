"""Signals description files: YAML in ROS 2 parameter-file form in, `Signals` out; the node reads the same file.

Aliases are refused, as the parameter parser of ROS 2 refuses them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ces_identify.config_file import read_yaml_tree, to_python
from ces_observer.errors import SignalsError
from ces_observer.signals import NAMES, Signals, override, quote

_Sections = list[tuple[str, yaml.MappingNode]]
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
    wildcard gives it) and a plain mapping of signals. Of a file for several dampers (its parameter `dampers` lists
    them) one is chosen by its name after the file's, `observer.yaml#front`: its own `front.position` and so on over
    what is said for all. Raises SignalsError naming the file and, if it can, the line.
    """
    if path is None:
        return Signals.from_mapping({}, "defaults")
    path, damper = _file_and_damper(path)
    root = read_yaml_tree(path, "a signals description, '/**: ros__parameters: position: ...'", SignalsError)
    sections = list(_sections(root, "")) or [("/**", root)]
    damper = _choose_damper(damper, _dampers(sections, path), path)
    common = _signals_of("", sections, path)
    own = _signals_of(damper, sections, path) if damper else {}
    if not common and not own:
        raise SignalsError(f"{path}: describes no signal; expected at least one of {', '.join(NAMES)} with its topic")
    merged = {}
    for name in {**common, **own}:
        (_, general), (line, special) = common.get(name, (0, None)), own.get(name, common.get(name, (0, None)))
        merged[name] = override(general, special)
        _check(name, merged[name], f"{path}:{line}")
    return Signals.from_mapping(merged, f"{path}#{damper}" if damper else str(path))


def _file_and_damper(path: Path) -> tuple[Path, str]:
    """Split `FILE#NAME`, unless there is a file of that very name."""
    stem, mark, damper = path.name.rpartition("#")
    return (path, "") if not mark or path.exists() else (path.with_name(stem), damper)


def _dampers(sections: _Sections, path: Path) -> list[str]:
    """Return the names in the parameter `dampers`; of several sections that have it, one node's own counts."""
    found: list[str] = []
    for _, parameters in sections:
        for key, value in parameters.value:
            if key.value == "dampers":
                given = to_python(value, path, SignalsError)
                if not isinstance(given, list) or not all(
                    isinstance(name, str) and name.isprintable() for name in given
                ):
                    raise SignalsError(
                        f"{path}:{key.start_mark.line + 1}: 'dampers' is {quote(given)}; expected a list of names, "
                        "such as [front, rear]"
                    )
                found = [name for name in given if name]
    return found


def _choose_damper(damper: str, known: list[str], path: Path) -> str:
    if damper and damper not in known:
        there = f"its dampers are {', '.join(known)}" if known else "it has no parameter 'dampers'"
        raise SignalsError(f"{path}: has no damper '{damper}'; {there}")
    if len(known) > 1 and not damper:
        raise SignalsError(
            f"{path}: describes the dampers {', '.join(known)}; say which one is meant, as in {path.name}#{known[0]}"
        )
    return damper or (known[0] if known else "")


def _signals_of(damper: str, sections: _Sections, path: Path) -> dict[str, tuple[int, Any]]:
    """Return line and description of each signal of one damper's own, or with no name of those said for all."""
    found: dict[str, list[_Description]] = {}
    for section, parameters in sorted(sections, key=lambda item: "*" not in item[0]):
        for name, key, value in _below(damper, parameters):
            signal, dot, rest = name.partition(".")
            if signal not in NAMES:
                continue
            content = {rest: to_python(value, path, SignalsError)} if dot else to_python(value, path, SignalsError)
            if _is_signal(content, sections):
                found.setdefault(signal, []).append(_Description(section, key.start_mark.line + 1, content))
    return {name: _merge(name, parts, path) for name, parts in found.items()}


def _below(damper: str, parameters: yaml.MappingNode) -> Iterator[tuple[str, yaml.Node, yaml.Node]]:
    """Yield name, key and value of the parameters whose names begin with `damper` and a dot, less that beginning."""
    for key, value in parameters.value:
        name = str(key.value)
        if not damper:
            yield name, key, value
        elif name.startswith(f"{damper}."):
            yield name.removeprefix(f"{damper}."), key, value
        elif name == damper and isinstance(value, yaml.MappingNode):
            yield from ((str(k.value), k, v) for k, v in value.value)


def _sections(node: yaml.MappingNode, name: str) -> Iterator[tuple[str, yaml.MappingNode]]:
    for key, value in node.value:
        if isinstance(value, yaml.MappingNode):
            if key.value == "ros__parameters":
                yield name, value
            else:
                yield from _sections(value, f"{name}/{str(key.value).strip('/')}")


def _is_signal(content: object, sections: _Sections) -> bool:
    """Tell a signal from another node's parameter of the same name, which only a file of several sections can have."""
    return len(sections) == 1 or (isinstance(content, Mapping) and not KEYS.isdisjoint(content))


def _merge(name: str, parts: list[_Description], path: Path) -> tuple[int, Any]:
    """Return one description for the signal, and the last line that adds to it, so that an error can name it."""
    exact = {part.section: part.line for part in parts if part.exact}
    if len(exact) > 1:
        places = " and ".join(f"{quote(section)} (line {line})" for section, line in exact.items())
        raise SignalsError(f"{path}: signal '{name}' is described for {places}; expected one node's signals in a file")
    merged: Any = {}
    for part in parts:
        both = isinstance(merged, Mapping) and isinstance(part.value, Mapping)
        merged = {**merged, **part.value} if both else part.value
    return parts[-1].line, merged


def _check(name: str, content: Any, where: str) -> None:
    try:
        Signals.from_mapping({name: content}, where)
    except SignalsError as error:
        raise SignalsError(str(error) if where in str(error) else f"{where}: signal '{name}': {error}") from None
