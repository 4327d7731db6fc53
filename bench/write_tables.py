"""Writes the tables of figures in the documents, by running the command that each names.

    python -m bench.write_tables [NAME...]

A table stands between two comments, of which the first names it and its command, run in the project's folder; what the
command prints goes between them, with the commit and the machine beneath:
<!-- NAME table: begin (COMMAND) --> ... <!-- NAME table: end -->
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from bench.markdown import replace_between
from bench.measurement import machine, processor

ROOT = Path(__file__).resolve().parent.parent
MARKER = re.compile(r"^<!-- ([\w-]+) table: begin \(([^)]+)\) -->$", re.MULTILINE)


@dataclass(frozen=True)
class MarkedTable:
    """A marked table: its page and its command."""

    page: Path
    command: str


def find_tables() -> Mapping[str, MarkedTable]:
    """Return the marked tables of all documents by name."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    found = [(name, MarkedTable(p, words)) for p in pages for name, words in MARKER.findall(p.read_text("utf-8"))]
    assert len(dict(found)) == len(found), f"a table is marked twice: {', '.join(name for name, _ in found)}"
    return dict(found)


def run_command(command: str) -> str:
    """Return what a command prints as Markdown, with commit and machine; `python3` is that of the shell, with ROS 2."""
    print(command, file=sys.stderr, flush=True)
    words = shlex.split(os.path.expandvars(command))
    words[0] = sys.executable if words[0] == "python" else words[0]
    table = _output_of(words)
    changed = " with changes" if _output_of(["git", "status", "--porcelain", "-uno"]) else ""
    where = "" if processor() in table else f"; {machine()}"
    return f"{table}\n\nCommit {_output_of(['git', 'rev-parse', '--short=8', 'HEAD'])}{changed}{where or '.'}"


def _output_of(words: list[str]) -> str:
    return subprocess.run(words, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()


def main() -> None:
    tables = find_tables()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"one or more of {', '.join(tables)} (default: all)")
    requested = parser.parse_args().names or list(tables)
    if unknown := sorted(set(requested) - set(tables)):
        parser.error(f"there is no table '{unknown[0]}'; expected one of {', '.join(tables)}")
    for name in requested:
        replace_between(tables[name].page, f"{name} table", run_command(tables[name].command))


if __name__ == "__main__":
    main()
