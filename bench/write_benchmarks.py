"""Rewrites the tables of docs/benchmarks.md by running their scripts.

Usage: python -m bench.write_benchmarks [NAME...]; with names, those tables only. A table is between two comments,
the first of which contains its name and its command, which prints the table on standard output:
<!-- NAME table: begin (python bench/SCRIPT.py OPTION...) --> ... <!-- NAME table: end -->
"""

from __future__ import annotations

import argparse
import re
import shlex
import subprocess
import sys
from pathlib import Path

from bench.markdown import replace_between

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "benchmarks.md"
COMMAND = re.compile(r"<!-- ([\w-]+) table: begin \(python ([^)]*)\) -->")


def run_script(command: str) -> str:
    """Return the output of a script as a Markdown table or, otherwise, as a code block."""
    print(f"python {command}", file=sys.stderr, flush=True)
    words = [sys.executable, *shlex.split(command)]
    text = subprocess.run(words, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()
    return text if text.startswith("|") else f"```\n{text}\n```"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = dict(COMMAND.findall(PAGE.read_text(encoding="utf-8")))
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"one or more of {', '.join(commands)}")
    requested = parser.parse_args().names or list(commands)
    if unknown := sorted(set(requested) - set(commands)):
        parser.error(f"{PAGE.name} has no table '{unknown[0]}'; expected one of {', '.join(commands)}")
    for name in requested:
        replace_between(PAGE, f"{name} table", run_script(commands[name]))


if __name__ == "__main__":
    main()
