"""Rewrites the tables of docs/benchmarks.md by running their scripts.

Usage: python bench/write_benchmarks.py [NAME...]; with names, those tables only. A table is between two comments,
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

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "benchmarks.md"
BLOCK = re.compile(
    r"(?P<begin><!-- (?P<name>[\w-]+) table: begin \(python (?P<command>[^)]*)\) -->\n).*?"
    r"(?P<end><!-- (?P=name) table: end -->)",
    re.DOTALL,
)


def run_script(command: str) -> str:
    """Return the output of a script as a Markdown table or, otherwise, as a code block."""
    print(f"python {command}", file=sys.stderr, flush=True)
    done = subprocess.run(
        [sys.executable, *shlex.split(command)], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True
    )
    text = done.stdout.strip()
    return text if text.startswith("|") else f"```\n{text}\n```"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = [block["name"] for block in BLOCK.finditer(PAGE.read_text(encoding="utf-8"))]
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"one or more of {', '.join(names)}")
    requested = parser.parse_args().names or names
    unknown = sorted(set(requested) - set(names))
    if unknown:
        parser.error(f"{PAGE.name} has no table '{unknown[0]}'; expected one of {', '.join(names)}")
    for name in requested:
        rewrite(name)


def rewrite(name: str) -> None:
    """Write a new table into the page, which is read after the script has run (this may take minutes)."""
    block = next(b for b in BLOCK.finditer(PAGE.read_text(encoding="utf-8")) if b["name"] == name)
    table = run_script(block["command"])

    def insert_table(found: re.Match[str]) -> str:
        return f"{found['begin']}{table}\n{found['end']}" if found["name"] == name else found[0]

    PAGE.write_text(BLOCK.sub(insert_table, PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
