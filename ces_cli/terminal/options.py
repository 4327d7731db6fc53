"""What programs are asked for: requests, which are records of options, and rules on which options apply together.

The options that several programs share are declared here, each once.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import inf
from pathlib import Path
from typing import Any, ClassVar, Self, get_args, get_type_hints

from ces_observer.errors import CesError
from ces_observer.fields import REQUIRED
from ces_observer.options import Option
from ces_observer.records import FIELD, declare

Values = Mapping[str, Any]  # of options, by their names
ALL = "*"


@dataclass(frozen=True)
class OptionRule:
    """The options `names` apply only if `applies` holds for the values; else the error is the option and `reason`.

    `names` are the options' attributes in words, `*` is all options that are not in `but`. In `reason`, {name} is the
    value of an option.
    """

    names: str
    applies: Callable[[Values], bool]
    reason: str
    but: str = ""

    def concerns(self, name: str) -> bool:
        """Return whether the rule is about the option `name`."""
        return name not in self.but.split() if self.names == ALL else name in self.names.split()


@dataclass(frozen=True, kw_only=True)
class ProgramRequest:
    """The base of what programs are asked for: frozen dataclasses, each field of which is declared by an option.

    `program` is its name, `about` what it does (if empty, the docstring says it), `example` lines that show it;
    `option_rules` say which options apply together. With `intermixed`, arguments may follow options. `parts` are the
    requests of subprograms by name.
    """

    program: ClassVar[str] = ""
    about: ClassVar[str] = ""
    example: ClassVar[str] = ""
    option_rules: ClassVar[Sequence[OptionRule]] = ()
    intermixed: ClassVar[bool] = False
    parts: ClassVar[Mapping[str, type[ProgramRequest]]] = {}

    @classmethod
    def options(cls) -> tuple[Option, ...]:
        """Return the options, those of its own before those of its bases, with the kinds of their annotations."""
        hints, settings = get_type_hints(cls), {f.name: f.metadata[FIELD] for f in fields(cls)}
        names = dict.fromkeys(name for base in cls.__mro__ for name in vars(base).get("__annotations__", ()))
        own = [name for name in names if name in settings]
        return tuple(_as_annotated(replace(settings[name], name=name), hints[name]) for name in own)

    @classmethod
    def of(cls, values: Values, given: Collection[str]) -> Self:
        """Return the request for the values of all its options, of which the user has `given` some by name."""
        return cls(**{option.name: as_field(option, values[option.name]) for option in cls.options()})


def _as_annotated(option: Option, hint: Any) -> Option:
    kind = next((kind for kind in get_args(hint) or (hint,) if kind in (int, float, str, Path)), bool)
    return replace(option, kind=kind)


def as_field(option: Option, value: Any) -> Any:
    """Return the value of an option as a request has it: a path as a Path, several values as a tuple."""
    make = Path if option.kind is Path else lambda item: item
    if isinstance(value, list | tuple):
        return tuple(map(make, value))
    return value if value is None else make(value)


def only_with(names: str, other: str, reason: str) -> OptionRule:
    """Return the rule that `names` apply only together with the option `other`."""
    return OptionRule(names, lambda values: bool(values.get(other)), reason)


NEED_REPORT = only_with("title note", "report", "is for the page; add --report FILE")


def never_with(names: str, other: str, reason: str, but: str = "") -> OptionRule:
    """Return the rule that `names` do not apply together with the option `other`."""
    return OptionRule(names, lambda values: not values.get(other), reason, but)


def require_applicable(given: Mapping[str, str], values: Values, rules: Sequence[OptionRule]) -> None:
    """Raise CesError for the first rule that options break; `given` maps their names to what the user wrote."""
    for rule in rules:
        wrong = next((text for name, text in given.items() if rule.concerns(name)), None)
        if wrong is not None and not rule.applies(values):
            raise CesError(f"{wrong} {rule.reason.format(**values)}")


def find_given(parser: argparse.ArgumentParser, words: Sequence[str], values: Values) -> dict[str, str]:
    """Return what the user gave, defaults too, by name: options and arguments as the user knows them."""
    given: dict[str, str] = {}
    for action in list_actions(parser):
        if not action.option_strings and values.get(action.dest) not in (action.default, None, []):
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


def option(default: Any = REQUIRED, meaning: str = "", low: float = -inf, high: float = inf, **settings: Any) -> Any:
    """Declare a field of a request by an option; its name and kind are those in the class."""
    return declare(Option(default=default, meaning=meaning, low=low, high=high, **settings))


def argument(default: Any = REQUIRED, meaning: str = "", **settings: Any) -> Any:
    """Declare a field of a request by a positional argument."""
    return declare(Argument(default=default, meaning=meaning, **settings))


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
PART = Option(
    "part",
    (),
    "use only this part of every recording given, in seconds from its start",
    0.0,
    kind=float,
    unit="s",
    none="all",
    metavar="FROM TO",
    many=True,
    together=True,
)
SIGNALS_FORM = "signals file (YAML); FILE#NAME for one of several dampers in it"
SIGNALS = Option("signals", None, SIGNALS_FORM, kind=Path, none="the packaged file", metavar="FILE")
REPORT = Option("report", None, f"write a report page (HTML); {IN_A_FOLDER}", kind=Path, metavar="FILE")
TITLE = Option("title", "", "title of the page", none="what was done with which recordings", metavar="TEXT")
NOTE = Option("note", "", "free text on the page: damper, operator, what was tested", metavar="TEXT")
OVERWRITE = Option("overwrite", False, "replace outputs that exist (default: refuse)")
JSON = Option("json", False, "print JSON for other programs instead of tables")
RIG_SEED = Option("seed", None, "random seed", 0, 2**31, kind=int, none="the experiment's own", metavar="N")
JOBS = Option("jobs", None, "processes", 1, 256, kind=int, none="all processors", metavar="N")


@dataclass(frozen=True, kw_only=True)
class OutputRequest(ProgramRequest):
    """A request of what writes files and says what it did."""

    json: bool = declare(JSON)
    overwrite: bool = declare(OVERWRITE)


@dataclass(frozen=True, kw_only=True)
class BagRequest(OutputRequest):
    """A request that signals files describe the bags of."""

    signals: Path | None = declare(SIGNALS)


@dataclass(frozen=True, kw_only=True)
class PageRequest(BagRequest):
    """A request of a page about recordings, or parts of them."""

    part: tuple[float, ...] = declare(PART)
    title: str = declare(TITLE)
    note: str = declare(NOTE)


@dataclass(frozen=True, kw_only=True)
class ReportRequest(PageRequest):
    """A request of figures, and of a page only with --report."""

    report: Path | None = declare(REPORT)
