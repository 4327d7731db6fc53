"""A node's table of options as YAML: what declares the parameters in C++, and the file that sets them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from math import isfinite
from textwrap import wrap
from typing import Any

import yaml

from ces_identify.export.export_c import text_literal
from ces_observer.nodes.parameter_table import type_name
from ces_observer.options import Option
from ces_observer.signals import LARGEST

TYPES = {"integer": "int", "integer_array": "int_array"}  # by ROS's name, where the library has another


def parameter_library(name: str, options: Iterable[Option]) -> str:
    """Return parameters.yaml for generate_parameter_library, which declares the `options` in the C++ namespace `name`.

    Ranges are checked by the validators `ces::within` and `ces::one_of`, whose words are those of the Python node.
    Raises ModelError for a text that cannot be printed.
    """
    tree: dict[str, Any] = {}
    for option in options:
        place = tree
        *groups, last = option.name.split(".")
        for group in groups:
            place = place.setdefault(group, {})
        place[last] = _declaration(option)
    return yaml.safe_dump({name: tree}, sort_keys=False, width=116, allow_unicode=True, default_flow_style=None)


def parameter_file(head: str, options: Iterable[Option]) -> str:
    """Return a ROS 2 parameter file with the defaults, each below its meaning; `head` is the comment that begins it."""
    lines, groups, told = [*_comment(head), "/**:", "  ros__parameters:"], set[str](), set[str]()
    for option in options:
        group, _, key = option.name.rpartition(".")
        if group and group not in groups:
            groups.add(group)
            lines += ["", f"    {group}:"]
        about = option.described.removeprefix(f"{group}: ")
        if about not in told:
            told.add(about)
            limits = f"; {option.phrase('').strip()}" if _is_limited(option) and option.high < LARGEST else ""
            lines += ([] if group else [""]) + _comment(
                f"{about}{limits}{' (live)' if option.live else ''}", len(group)
            )
        lines.append(f"{' ' * (6 if group else 4)}{key}: {json.dumps(option.default)}")
    return "\n".join(lines) + "\n"


def _comment(text: str, depth: int | None = None) -> list[str]:
    indent = "" if depth is None else " " * (6 if depth else 4)
    return wrap(text, 120, initial_indent=f"{indent}# ", subsequent_indent=f"{indent}# ", break_on_hyphens=False)


def _is_limited(option: Option) -> bool:
    return option.kind in (int, float) and isfinite(option.high)


def _declaration(option: Option) -> dict[str, Any]:
    """Return the declaration of one parameter; the library writes texts into C++ as they are."""
    kind = type_name(option).lower()
    declared: dict[str, Any] = {"type": TYPES.get(kind, kind)}
    if option.default is not None:
        default = option.default
        declared["default_value"] = text_literal(default)[1:-1] if isinstance(default, str) else default
    declared |= {"description": option.described.replace('"', "'"), "read_only": not option.live}
    if option.choices or _is_limited(option):
        declared["additional_constraints"] = option.expected
    if option.choices:
        declared["validation"] = {"ces::one_of<>": [list(option.choices)]}
    elif option.kind in (int, float) and not option.many:
        declared["validation"] = {"ces::within<>": [option.kind(option.low), option.kind(option.high)]}
    return declared
