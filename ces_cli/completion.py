"""`ces completion`: prints a script that completes programs, options, choices and file names in a shell.

The script is generated from the programs' own option tables by shtab. It is static: nothing of `ces` runs at a TAB.
"""

from __future__ import annotations

import argparse
import re
import textwrap
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ces_cli.terminal import terminal
from ces_cli.terminal.options import Argument, list_actions
from ces_observer.errors import CesError

if TYPE_CHECKING:
    from ces_cli.main import ProgramTable

SHELLS = ("bash", "zsh", "fish")
ANY_FILE, FOLDER = "file", "folder"
BAG_FILES, YAML_FILES = ("*.mcap", "*.db3"), ("*.yaml", "*.yml")
MAX_ABOUT = 72  # characters of a description
OPTION_RULE = '"$current_action_is_positional" = true'  # in shtab's script for bash: when a word with - is an option
KINDS: dict[str, str | tuple[str, ...]] = {  # what completes a value, by the option's name, else by its metavar
    "--signals": YAML_FILES,
    "--candidates": YAML_FILES,
    "--mapping": YAML_FILES,
    "--report": ("*.html",),
    "--sim": ("*.json", "*.yaml", "*.fmu"),
    "--teacher": ("*.json", "*.yaml", "*.fmu"),
    "BAG": BAG_FILES,
    "BAG2": FOLDER,
    "DIR": FOLDER,
    "RESULTS": FOLDER,
    "PLAN": YAML_FILES,
    "EXPERIMENT": YAML_FILES,
    "FILE.yaml": YAML_FILES,
    "MAP.yaml": YAML_FILES,
    "MODEL.json": ("*.json",),
    "FILE.csv": ("*.csv",),
    "REPORT.md": ("*.md",),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status. Raises CesError if shtab is missing or too old for the shell."""
    options = make_parser().parse_args(argv)
    print(completion_script(options.shell))
    return 0


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    return terminal.parser(
        "completion",
        "Print a script that completes programs, options, choices and file names at the TAB key.",
        "ces completion bash > ~/.local/share/bash-completion/completions/ces\n"
        "  ces completion zsh > ~/.zfunc/_ces        (a folder of fpath)\n"
        "  ces completion fish > ~/.config/fish/completions/ces.fish",
        Argument("shell", meaning=f"one of {', '.join(SHELLS)}", choices=SHELLS, metavar="SHELL"),
    )


def completion_script(shell: str) -> str:
    """Return the script for a shell."""
    from ces_cli.main import PROGRAMS

    shtab = _import_shtab()
    if shell not in shtab.SUPPORTED_SHELLS:
        raise CesError(f"shtab {shtab.__version__} does not know {shell}; expected a newer one: pip install -U shtab")
    script = str(shtab.complete(build_whole_parser(PROGRAMS), shell))
    if shell != "bash":
        return script
    # Offer options also after one with several values: `--validate A B --o`.
    return script.replace(OPTION_RULE, f'{OPTION_RULE} || "$current_action_nargs" = [+*]')


def build_whole_parser(programs: ProgramTable) -> argparse.ArgumentParser:
    """Return a parser of `ces` with all programs as its subparsers, each value marked with what completes it."""
    whole = argparse.ArgumentParser(prog="ces")
    whole.add_argument("--version", action="store_true", help="show the versions in use")
    parts = whole.add_subparsers()
    for name, (module, summary) in programs.items():
        own = import_module(f"ces_cli.{module}").make_parser()
        part = parts.add_parser(name, help=summary, parents=[own], add_help=False)
        for action in list_actions(part):
            if action.help:  # its first part, short enough for a list of completions
                action.help = textwrap.shorten(re.split(r"[;(]", action.help)[0], MAX_ABOUT, placeholder=" …")
            mark_action(action)
    about = "show the help of a program"
    parts.add_parser("help", help=about).add_argument("program", choices=tuple(programs), help=about)
    return whole


def mark_action(action: argparse.Action) -> None:
    """Give an action the attribute `complete`, from which shtab takes what completes its value."""
    kind = find_kind(action)
    if kind is not None:
        shtab = _import_shtab()
        forms = {ANY_FILE: shtab.FILE, FOLDER: shtab.DIRECTORY}
        action.complete = forms[kind] if isinstance(kind, str) else shtab.glob(*kind)  # type: ignore[attr-defined]


def find_kind(action: argparse.Action) -> str | tuple[str, ...] | None:
    """Return what completes an action's value: a kind, patterns of file names, or None for choices, flags, numbers."""
    if action.choices is not None or action.nargs == 0:
        return None
    names = (*action.option_strings, str(action.metavar))
    return next((KINDS[name] for name in names if name in KINDS), ANY_FILE if action.type is Path else None)


def _import_shtab() -> Any:
    try:
        return import_module("shtab")
    except ImportError:
        raise CesError("shtab is not installed; it writes the completion: pip install 'shtab>=1.13'") from None
