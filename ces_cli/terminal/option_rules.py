"""Which options of a program apply with which others: a table beside the options, checked when they are parsed."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ces_observer.errors import CesError

Condition = Callable[[argparse.Namespace], bool]
ALL = "*"


@dataclass(frozen=True)
class OptionRule:
    """The options `names` apply only if `applies` holds; else the error is the option followed by `reason`.

    `names` are the options' attributes in words, `*` is all options that are not in `but`. In `reason`, {name} is the
    value of an option.
    """

    names: str
    applies: Condition
    reason: str
    but: str = ""

    def concerns(self, name: str) -> bool:
        """Return whether the rule is about the option `name`."""
        return name not in self.but.split() if self.names == ALL else name in self.names.split()


def only_with(names: str, other: str, reason: str) -> OptionRule:
    """Return the rule that `names` apply only together with the option `other`."""
    return OptionRule(names, lambda options: bool(getattr(options, other, None)), reason)


def never_with(names: str, other: str, reason: str, but: str = "") -> OptionRule:
    """Return the rule that `names` do not apply together with the option `other`."""
    return OptionRule(names, lambda options: not getattr(options, other, None), reason, but)


def require_applicable(given: Mapping[str, str], options: argparse.Namespace, rules: Sequence[OptionRule]) -> None:
    """Raise CesError for the first rule that options break; `given` maps their attributes to what the user wrote."""
    for rule in rules:
        wrong = next((text for name, text in given.items() if rule.concerns(name)), None)
        if wrong is not None and not rule.applies(options):
            raise CesError(f"{wrong} {rule.reason.format(**vars(options))}")


def find_given(parser: argparse.ArgumentParser, words: Sequence[str], options: argparse.Namespace) -> dict[str, str]:
    """Return the options and positional arguments on a command line that was parsed, by attribute, as users know them.

    An option that was given its default counts, which the values alone do not show.
    """
    given: dict[str, str] = {}
    for action in _list_actions(parser):
        if not action.option_strings and getattr(options, action.dest, None) not in (action.default, None, []):
            given[action.dest] = str(action.metavar or action.dest)
    by_text = {text: action for action in _list_actions(parser) for text in action.option_strings}
    for word in words[: words.index("--")] if "--" in words else words:
        name = word.partition("=")[0]
        starts = [text for text in by_text if name.startswith("--") and text.startswith(name)]
        for text in [name] if name in by_text else starts[:1]:
            given[by_text[text].dest] = by_text[text].option_strings[-1]
    return given


def _list_actions(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    """Return the options and arguments of a parser and its subcommands."""
    actions: list[argparse.Action] = []
    for action in parser._actions:  # argparse has no public list
        actions.append(action)
        choices: Any = action.choices
        if isinstance(action, argparse._SubParsersAction):
            actions += [inner for sub in choices.values() for inner in _list_actions(sub)]
    return actions
