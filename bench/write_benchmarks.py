"""Rewrites the tables of docs/benchmarks.md and docs/speed.md by running their scripts.

Usage: python -m bench.write_benchmarks [NAME...]; with names, those tables only. A table is between two comments,
the first of which contains its name and its command, which prints the table on standard output; the commit is added:
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
PAGES = (ROOT / "docs/benchmarks.md", ROOT / "docs/speed.md")
COMMAND = re.compile(r"<!-- ([\w-]+) table: begin \(python ([^)]*)\) -->")


def run_script(command: str) -> str:
    """Return the output of a script as a Markdown table or, otherwise, as a code block."""
    print(f"python {command}", file=sys.stderr, flush=True)
    words = [sys.executable, *shlex.split(command)]
    text = subprocess.run(words, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()
    table = text if text.startswith("|") else f"```\n{text}\n```"
    commit = subprocess.run(
        ("git", "rev-parse", "--short=8", "HEAD"), cwd=ROOT, check=True, capture_output=True, text=True
    )
    return f"{table}\n\nCommit {commit.stdout.strip()}."


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    found = {name: (page, command) for page in PAGES for name, command in COMMAND.findall(page.read_text("utf-8"))}
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"one or more of {', '.join(found)}")
    requested = parser.parse_args().names or list(found)
    if unknown := sorted(set(requested) - set(found)):
        parser.error(f"there is no table '{unknown[0]}'; expected one of {', '.join(found)}")
    for name in requested:
        page, command = found[name]
        replace_between(page, f"{name} table", run_script(command))


if __name__ == "__main__":
    main()
