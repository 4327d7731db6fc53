"""An option: a field that a program, a node, a plan and the API share, under one name.

`ces_cli.terminal` makes an argument of it (`--no-band` for `band`), a node a parameter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from ces_observer.fields import REQUIRED, Field


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
        if self.default in (REQUIRED, None, (), []):
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
