"""Markdown tables, and the marked places in documents for them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from ces_observer.json_text import write_atomically
from ces_report.table import text_table


def markdown(rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Return a Markdown table: the first row is the heading, columns after the first `left` are right-aligned."""
    return text_table(rows[0], rows[1:], left=left).to_markdown()


def replace_between(path: Path, name: str, body: str) -> None:
    """Replace the text between the markers `name` in a Markdown file; raises ValueError if they are missing."""
    found = between(path, name)
    text = path.read_text("utf-8")
    write_atomically(path, f"{text[: found.start(1)]}{body}\n{text[found.end(1) :]}")


def between(path: Path, name: str) -> re.Match[str]:
    """Return the match of the markers `name`, with the text between as first group; raises ValueError if missing."""
    pattern = rf"<!-- {name}: begin[^\n]*-->\n(.*?)<!-- {name}: end -->"
    found = re.search(pattern, path.read_text("utf-8"), flags=re.DOTALL)
    if found is None:
        raise ValueError(f"{path}: no markers '{name}: begin' and '{name}: end'; insert them where the table belongs")
    return found
