"""The common base of all errors that a user can correct, and how each user reads the names of options in them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NoReturn

LIKE = 0.7  # of a name's letters, in what it may have meant


@dataclass(frozen=True)
class OptionName:
    """An option that an error names, with the value that it has or should have; each user writes it differently."""

    name: str
    value: object = None

    def as_keyword(self) -> str:
        """Return it as Python has it: `delay`, `delay=0.003`, `band=False`."""
        return self.name if self.value is None else f"{self.name}={self._text if self._is_number else repr(self.value)}"

    def as_flag(self) -> str:
        """Return it as a command line has it: `--delay`, `--delay 0.003`, `--no-band`."""
        flag = f"--{'no-' if self.value is False else ''}{self.name.replace('_', '-')}"
        return flag if self.value is None or isinstance(self.value, bool) else f"{flag} {self._text}"

    def as_parameter(self) -> str:
        """Return it as a node's parameter: `parameter 'delay'`, `parameter delay:=0.003`, `parameter band:=false`."""
        return f"parameter '{self.name}'" if self.value is None else f"parameter {self.name}:={self._text}"

    def as_key(self) -> str:
        """Return it as a key of a YAML file: `delay`, `delay: 0.003`, `band: false`."""
        return self.name if self.value is None else f"{self.name}: {self._text}"

    @property
    def _is_number(self) -> bool:
        return isinstance(self.value, int | float) and not isinstance(self.value, bool)

    @property
    def _text(self) -> str:
        if isinstance(self.value, bool):
            return str(self.value).lower()
        return f"{self.value:g}" if self._is_number else str(self.value)


@dataclass(frozen=True)
class Words:
    """A text of an error in programs, and what Python says in its place."""

    program: str
    script: str


def suggest(name: str, known: Iterable[str]) -> str:
    """Return what a mistyped name may have meant, as `; did you mean 'time'?`, else what is known."""
    from difflib import get_close_matches  # not on the vehicle

    names = list(known)
    near = get_close_matches(name, names, n=1, cutoff=LIKE)
    return f"; did you mean '{near[0]}'?" if near else f"; expected one of {', '.join(names)}"


class Suggesting:
    """What has public names: an unknown one raises an AttributeError with the near ones."""

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> NoReturn:
            raise AttributeError(
                f"{type(self).__name__} has no '{name}'{'' if name[0] == '_' else self._suggest(name)}"
            )

    def _suggest(self, name: str) -> str:
        return suggest(name, [known for known in dir(self) if not known.startswith("_")])


Wording = Callable[[OptionName], str]


class CesError(Exception):
    """One line: what is wrong, where, what was expected, what to do. Programs print it and exit with status 2.

    It is made of texts and of the options that it names; as text, it names them as Python does.
    """

    def __init__(self, *parts: str | OptionName | Words) -> None:
        super().__init__(*parts)

    def __str__(self) -> str:
        return self.word(OptionName.as_keyword)

    def word(self, wording: Wording) -> str:
        """Return the line for a user who writes options as `wording` does."""
        is_script = wording is OptionName.as_keyword
        plain = ((p.script if is_script else p.program) if isinstance(p, Words) else p for p in self.args)
        return "".join(wording(part) if isinstance(part, OptionName) else str(part) for part in plain)


class SignalsError(CesError):
    """A signals description that cannot be used."""


class ModelError(CesError):
    """A model file that cannot be used."""


class RecordingError(CesError):
    """A recording that cannot be read, or whose samples cannot be used."""
