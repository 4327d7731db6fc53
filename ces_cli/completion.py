"""`ces completion`: prints a script that completes programs, options, choices and file names in a shell.

The script is generated from the programs' own option tables by shtab. It is static: nothing of `ces` runs at a TAB.
"""

from __future__ import annotations

import argparse
import re
import textwrap
from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ces_cli.terminal import terminal
from ces_cli.terminal.options import Argument, list_actions
from ces_observer.errors import CesError

if TYPE_CHECKING:
    from ces_cli.main import ProgramTable

SHELLS = ("bash", "zsh", "fish")
MAX_ABOUT = 72  # characters of a description
OPTION_RULE = '"$current_action_is_positional" = true'  # in shtab's script for bash: when a word with - is an option


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
    """Return a parser of `ces` with all programs as subparsers; file names complete values without choices."""
    shtab = _import_shtab()
    whole = argparse.ArgumentParser(prog="ces")
    whole.add_argument("--version", action="store_true", help="show the versions in use")
    parts = whole.add_subparsers()
    for name, (module, summary) in programs.items():
        own = import_module(f"ces_cli.{module}").make_parser()
        part = parts.add_parser(name, help=summary, parents=[own], add_help=False)
        for action in list_actions(part):
            if action.help:  # its first part, short enough for a list of completions
                action.help = textwrap.shorten(re.split(r"[;(]", action.help)[0], MAX_ABOUT, placeholder=" …")
            if action.choices is None and action.nargs != 0:
                action.complete = shtab.FILE  # type: ignore[attr-defined]  # from which shtab takes what completes it
    about = "show the help of a program"
    parts.add_parser("help", help=about).add_argument("program", choices=tuple(programs), help=about)
    return whole


def _import_shtab() -> Any:
    try:
        return import_module("shtab")
    except ImportError:
        raise CesError("shtab is not installed; it writes the completion: pip install 'shtab>=1.13'") from None
