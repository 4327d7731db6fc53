"""The page of programs, from their parsers."""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Iterator
from importlib import import_module

from bench.reference.tables import as_text, codes, table
from ces_cli.main import PROGRAMS
from ces_cli.terminal import terminal
from ces_cli.terminal.inputs import HELP as SIM
from ces_cli.terminal.options import ProgramRequest

SHARED_BY = 2  # programs from which on an option is described once, at the top
DEFAULT = re.compile(r"[;,]? ?\(?default:? ([^()]*(?:\([^()]*\))?[^()]*?)\)?$")
HEAD = f"""
Without ROS 2 `ces NAME`, with it sourced also `ros2 run ces_observer NAME`; `ces NAME --help` has examples. A mistake
ends a program with status 2 and one line that says what to do. SIM is a simulation: {SIM}.
"""


def programs_page() -> str:
    """Return the page."""
    parsers = {name: dict(_parts(name, parser_of(name))) for name in PROGRAMS}
    counts = Counter(_key(action) for parts in parsers.values() for p in parts.values() for action in _options(p))
    shared = {key for key, count in counts.items() if count >= SHARED_BY and key[2]}
    text = ["# Programs", HEAD, table(("option of several programs", "default", "meaning"), sorted(shared))]
    for name, (_, summary) in PROGRAMS.items():
        text.append(f"## `{name}`\n\n{summary[0].upper()}{summary[1:]}.")
        for words, parser in parsers[name].items():
            own = [_row(action) for action in _options(parser) if _key(action) not in shared]
            common = codes(a.option_strings[-1] for a in _options(parser) if _key(a) in shared)
            text.append(f"`ces {words}{_arguments(parser)}`{', also ' + common if common else ''}\n")
            if own:
                text.append(table(("option", "default", "meaning"), own))
    return "\n".join(text)


def parser_of(name: str) -> argparse.ArgumentParser:
    """Return the parser of a program."""
    import_module(f"ces_cli.{PROGRAMS[name][0]}")
    return terminal.parser(next(request for request in _list_requests(ProgramRequest) if request.program == name))


def _list_requests(base: type[ProgramRequest]) -> Iterator[type[ProgramRequest]]:
    for request in base.__subclasses__():
        yield request
        yield from _list_requests(request)


def _parts(name: str, parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Yield the words and the parser of a program, or those of its parts."""
    parts = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    if not parts:
        yield name, parser
    for action in parts:
        yield from ((f"{name} {part}", own) for part, own in action.choices.items())


def _options(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    return [action for action in parser._actions if action.option_strings and action.dest != "help"]


def _arguments(parser: argparse.ArgumentParser) -> str:
    words = ""
    for action in parser._actions:
        if not action.option_strings:
            name = action.metavar or action.dest.upper()
            more = "…" if action.nargs in ("+", "*") else ""
            words += f" [{name}{more}]" if action.nargs in ("?", "*") else f" {name}{more}"
    return words


def _key(action: argparse.Action) -> tuple[str, str, str]:
    option, default, meaning = _row(action)
    return option, default, meaning


def _row(action: argparse.Action) -> tuple[str, str, str]:
    text = (action.help or "").replace("%%", "%").replace(SIM, "see above")
    default = DEFAULT.search(text)
    value = default[1] if default else ("required" if action.required else "")
    meaning = text[: default.start()] if default else text
    if not default and action.default not in (None, False, [], ()) and action.nargs != 0:
        value = as_text(action.default)
    metavar = action.metavar if isinstance(action.metavar, str) else ""
    return f"`{action.option_strings[-1]}{' ' + metavar if metavar else ''}`", value, meaning
