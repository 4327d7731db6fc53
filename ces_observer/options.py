"""An option: a field that a program, a node, a plan and the API share, under one name.

`ces_cli.terminal` makes an argument of it (`--no-band` for `band`) and `as_parameter` the parameter of a node.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from ces_observer.fields import REQUIRED, Field

NO_WORDS = [""]  # ROS 2 has no empty list of strings; empty strings are ignored


@dataclass(frozen=True)
class Option(Field):
    """A field with a name for users; `none` says what applies where it is not given, its default then being None.

    One without a default must be given. On a command line, a list is given in one option with `together`, else by
    repeating the option; `group` heads it in the help. A `live` parameter can change while the node runs.
    """

    metavar: str = ""
    none: str = ""
    group: str = ""
    together: bool = False
    live: bool = False

    @classmethod
    def from_field(cls, declared: Field, **changes: Any) -> Option:
        """Return a field that is declared elsewhere as an option, with `changes`."""
        return cls(**{one.name: getattr(declared, one.name) for one in fields(Field)} | changes)

    @property
    def flag(self) -> str:
        """Its name on a command line; that of a switch that is on by default turns it off."""
        return f"--{'no-' if self.default is True else ''}{self.name.replace('_', '-')}"

    @property
    def help(self) -> str:
        """Its help on a command line."""
        if self.kind is bool:
            return f"do not {self.meaning}" if self.default is True else self.meaning
        text = self.described + ("; may be repeated" if self.many and not self.together else "")
        if self.default in (REQUIRED, None, "", (), []):
            return text + (f" (default: {self.none})" if self.none else "")
        defaults = self.default if self.many else [self.default]
        words = " ".join(f"{one:g}" if self.kind is float else str(one) for one in defaults)
        return f"{text} (default {words})"

    def check_parameter(self, value: Any, name: str = "") -> Any:
        """Return the value for the parameter `name` of a node (default: its own); raises CesError."""
        return self.check(value, f"parameter '{name or self.name}'")


def in_group(title: str, *options: Option) -> tuple[Option, ...]:
    """Return the options under the heading `title` of a program's help."""
    return tuple(replace(option, group=title) for option in options)


def as_parameter(option: Option) -> Option:
    """Return an option as a node's parameter: ROS 2 has no empty value, so that 0 or an empty text stands for it."""
    kind = str if option.kind is Path else option.kind
    if option.many:
        return replace(option, kind=kind, default=list(option.default) or NO_WORDS)
    if option.default is not None:
        return replace(option, kind=kind, default=str(option.default) if kind is str else option.default)
    unset, word = ("", "empty") if kind is str else (kind(0), "0")
    least = "" if kind is str or option.low <= 0 else f", at least {option.low:g}"
    meaning = f"{option.described}{least}; {word}: {option.none or 'none'}"
    choices = (unset, *option.choices) if option.choices else ()
    return replace(option, kind=kind, default=unset, choices=choices, meaning=meaning, unit="", low=min(option.low, 0))


def given_values(options: Iterable[Option], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return those values of a node's parameters that are set and differ from the defaults, paths as texts."""
    given = {}
    for option in options:
        value, unset = values[option.name], as_parameter(option).default
        if value in (unset, ""):
            continue
        texts = [one for one in value if one != ""] if option.many else [value]
        texts = [str(Path(one).expanduser()) for one in texts] if option.kind is Path else texts
        given[option.name] = texts if option.many else texts[0]
    return given
