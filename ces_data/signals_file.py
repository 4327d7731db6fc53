"""Signals files: YAML in ROS 2 parameter-file form in, `Signals` out; the node reads the same file.

Aliases are refused, as in the parameter parser of ROS 2.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from ces_data.config_file import read_yaml_tree, to_python
from ces_data.limits import TableLimits
from ces_observer.errors import SignalsError
from ces_observer.json_text import quote
from ces_observer.signals import FIELDS, NAMES, Signals, override

_Sections = list[tuple[str, yaml.MappingNode]]
PARAMETERS = "ros__parameters"
KEYS = frozenset(FIELDS)


def load_signals(path: Path | None = None) -> Signals:
    """Read a signals file; the defaults if `path` is None.

    Accepted are parameter files with any node names, namespaces and wildcards (a named node overrides a wildcard) and a
    plain mapping of signals. If the parameter `dampers` lists several dampers, `observer.yaml#front` selects one: its
    own `front.position` and so on override the common signals. Raises SignalsError with the file and, if known, the
    line.
    """
    if path is None:
        return Signals.from_mapping({}, "defaults")
    stem, mark, damper = ("", "", "") if path.exists() else path.name.rpartition("#")
    path = path.with_name(stem) if mark else path
    root = read_yaml_tree(path, "a signals file, '/**: ros__parameters: position: ...'", SignalsError)
    sections = list(_sections(root, "")) or [("/**", root)]
    damper = _choose_damper(damper if mark else "", _dampers(sections, path), path)
    common = _signals_of("", sections, path)
    own = _signals_of(damper, sections, path) if damper else {}
    if not common and not own:
        hint = _find_misspelled_section(root)
        expected = f"expected at least one of {', '.join(NAMES)} with its topic"
        raise SignalsError(f"{path}: describes no signal; {hint}{expected}")
    merged = {}
    for name in {**common, **own}:
        (_, general), (line, special) = common.get(name, (0, None)), own.get(name, common.get(name, (0, None)))
        merged[name] = override(general, special)
        where = f"{path}:{line}"
        try:
            Signals.from_mapping({name: merged[name]}, where)
        except SignalsError as error:
            raise SignalsError(str(error) if where in str(error) else f"{where}: signal '{name}': {error}") from None
    return Signals.from_mapping(merged, f"{path}#{damper}" if damper else str(path))


def _dampers(sections: _Sections, path: Path) -> list[str]:
    """Return the names in the parameter `dampers` of the last section that has it."""
    dampers: list[str] = []
    for key, value in (entry for _, parameters in sections for entry in parameters.value):
        if key.value == "dampers":
            names = to_python(value, path, SignalsError)
            if not isinstance(names, list) or not all(isinstance(n, str) and n.isprintable() for n in names):
                where, expected = f"{path}:{key.start_mark.line + 1}", "a list of names, such as [front, rear]"
                raise SignalsError(f"{where}: 'dampers' is {quote(names)}; expected {expected}")
            dampers = [name for name in names if name]
    return dampers


def _choose_damper(damper: str, known: list[str], path: Path) -> str:
    if damper and damper not in known:
        reason = f"its dampers are {', '.join(known)}" if known else "it has no parameter 'dampers'"
        raise SignalsError(f"{path}: has no damper '{damper}'; {reason}")
    if len(known) > 1 and not damper:
        raise SignalsError(f"{path}: describes the dampers {', '.join(known)}; select one, as in {path}#{known[0]}")
    return damper or (known[0] if known else "")


def _signals_of(damper: str, sections: _Sections, path: Path) -> dict[str, tuple[int, Any]]:
    """Return line and description of each signal of one damper, or of the common signals if `damper` is empty."""
    parts: dict[str, list[tuple[str, int, Any]]] = {}  # section, line and description, those of wildcards first
    for section, parameters in sorted(sections, key=lambda item: "*" not in item[0]):
        for name, key, value in _below(damper, parameters):
            line, (signal, dot, rest) = key.start_mark.line + 1, name.partition(".")
            if signal not in NAMES:
                _refuse_typo(signal, rest, value, f"{path}:{line}")
                continue
            content = to_python(value, path, SignalsError)
            content = {rest: content} if dot else content
            described = isinstance(content, Mapping) and not KEYS.isdisjoint(content)
            if described or len(sections) == 1:  # else another node's parameter of the same name
                parts.setdefault(signal, []).append((section, line, content))
    return {name: _merge(name, own, path) for name, own in parts.items()}


def _refuse_typo(name: str, rest: str, value: yaml.Node, where: str) -> None:
    """Raise SignalsError for a signal's description under almost a signal's name; others are the node's own."""
    keys = {str(key.value) for key, _ in value.value} if isinstance(value, yaml.MappingNode) else {rest}
    similar = difflib.get_close_matches(name.lower(), NAMES, n=1, cutoff=TableLimits.SIMILAR_NAME)
    if similar and not keys.isdisjoint(KEYS):
        raise SignalsError(f"{where}: no signal {name!r}; did you mean {similar[0]}? Signals are {', '.join(NAMES)}")


def _below(damper: str, parameters: yaml.MappingNode) -> Iterator[tuple[str, yaml.Node, yaml.Node]]:
    """Yield name, key and value of the parameters whose names begin with `damper` and a dot, which are removed."""
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
            if key.value == PARAMETERS:
                yield name, value
            else:
                yield from _sections(value, f"{name}/{str(key.value).strip('/')}")


def _find_misspelled_section(node: yaml.MappingNode) -> str:
    """Return a hint at a key that is almost 'ros__parameters', empty if there is none."""
    for key, value in node.value:
        name = str(key.value)
        if name != PARAMETERS and difflib.get_close_matches(name, [PARAMETERS], cutoff=TableLimits.SIMILAR_NAME):
            return f"line {key.start_mark.line + 1}: {name!r}: did you mean {PARAMETERS}? "
        if isinstance(value, yaml.MappingNode) and (hint := _find_misspelled_section(value)):
            return hint
    return ""


def _merge(name: str, parts: list[tuple[str, int, Any]], path: Path) -> tuple[int, Any]:
    """Return the last line that adds to a signal, for errors, and the merged description."""
    nodes = {section: line for section, line, _ in parts if "*" not in section}
    if len(nodes) > 1:
        places = " and ".join(f"{quote(section)} (line {line})" for section, line in nodes.items())
        raise SignalsError(f"{path}: signal '{name}' is described for {places}; expected one node's signals in a file")
    merged: Any = {}
    for _, _, value in parts:
        both = isinstance(merged, Mapping) and isinstance(value, Mapping)
        merged = {**merged, **value} if both else value
    return parts[-1][1], merged
