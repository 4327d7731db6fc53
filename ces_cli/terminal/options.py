"""The options that several programs share, each declared once, and rules on which options apply with which others."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ces_observer.errors import CesError
from ces_observer.fields import REQUIRED
from ces_observer.options import Option

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
    """Return what the user gave, defaults too, by attribute: options and arguments as the user knows them."""
    given: dict[str, str] = {}
    for action in list_actions(parser):
        if not action.option_strings and getattr(options, action.dest, None) not in (action.default, None, []):
            given[action.dest] = str(action.metavar or action.dest)
    by_text = {text: action for action in list_actions(parser) for text in action.option_strings}
    for word in words[: words.index("--")] if "--" in words else words:
        name = word.partition("=")[0]
        starts = [text for text in by_text if name.startswith("--") and text.startswith(name)]
        for text in [name] if name in by_text else starts[:1]:
            given[by_text[text].dest] = by_text[text].option_strings[-1]
    return given


def list_actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield the options and arguments of a parser and of its subparsers."""
    for action in parser._actions:  # argparse has no public list
        if isinstance(action, argparse._SubParsersAction):
            for part in action.choices.values():
                yield from list_actions(part)
        else:
            yield action


@dataclass(frozen=True)
class Argument(Option):
    """A positional argument; `count` is ? for one that may be left out, + or * for several."""

    together: bool = True
    count: str = ""


@dataclass(frozen=True)
class PartOption(Option):
    """A part of a recording: FROM:TO, shares from 0 to 1."""

    def parse(self, text: str) -> tuple[float, float]:
        """Return both ends of the part; raises CesError."""
        first, _, last = text.partition(":")
        with suppress(ValueError):
            share = float(first or 0.0), float(last or 1.0)
            if 0.0 <= share[0] < share[1] <= 1.0:
                return share
        raise CesError(f"'{text}' is not FROM:TO with 0 <= FROM < TO <= 1, such as 0.6:1")


IN_A_FOLDER = "in a folder: under a name that says which simulation and recordings"
BAGS_FORM = "bags, folders of bags, or globs"
MODEL = Argument("model", kind=Path, metavar="MODEL.json")
ONE_BAG = Argument("bag", meaning="recording: a bag, or a folder or glob that names one", metavar="BAG")
BAGS = Argument("bags", (), "rosbag2 folder, .mcap, .db3 or .bag file, or a glob", metavar="BAG", count="+")
REAL = Option(
    "real",
    REQUIRED,
    "recordings of the real damper: bags, folders, globs",
    kind=str,
    metavar="BAG",
    together=True,
    many=True,
)
HELD_OUT = Option(
    "held_out", (), "recordings for evaluation only", none="a part of --real is held out", metavar="BAG", together=True
)
FIT = Option(
    "fit",
    (),
    "parameters of the simulation that may change; NAME=LOW..HIGH bounds one (a whole number: each is tried)",
    none="all that it declares",
    metavar="NAME[=LOW..HIGH]",
    together=True,
)
PART = PartOption("part", "0:1", "part of each recording to use, from 0 to 1", metavar="FROM:TO")
SIGNALS_FORM = "signals file (YAML); FILE#NAME for one of several dampers in it"
SIGNALS = Option("signals", None, SIGNALS_FORM, kind=Path, none="the packaged file", metavar="FILE")
REPORT = Option("report", None, f"write a report page (HTML); {IN_A_FOLDER}", kind=Path, metavar="FILE")
OVERWRITE = Option("overwrite", False, "replace outputs that exist (default: refuse)")
JSON = Option("json", False, "print JSON for other programs instead of tables")
RIG_SEED = Option("seed", None, "random seed", 0, 2**31, kind=int, none="the experiment's own", metavar="N")
JOBS = Option("jobs", None, "processes", 1, 256, kind=int, none="all processors", metavar="N")
