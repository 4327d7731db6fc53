"""Text for the generated pages: tables without padding, marked words, and numbers as a person writes them."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Iterable, Sequence
from typing import Any

from bench.markdown import markdown


def table(heading: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table; a cell's bars and line ends are replaced."""
    cells = [[re.sub(r"\s+", " ", cell).replace("|", "\\|").strip() for cell in row] for row in (heading, *rows)]
    return f"{markdown(cells, left=len(heading))}\n"


def code(text: str) -> str:
    """Return a text as code, nothing for an empty one."""
    return f"`{text}`" if text else ""


def codes(texts: Iterable[str]) -> str:
    """Return several texts as code, with commas between."""
    return ", ".join(map(code, texts))


def first_paragraph(thing: Any) -> str:
    """Return the first paragraph of an object's own documentation, on one line."""
    return paragraphs(thing)[0] if paragraphs(thing) else ""


def paragraphs(thing: Any) -> list[str]:
    """Return the paragraphs of an object's own documentation, each on one line; none if it has not been given any."""
    text = inspect.cleandoc(vars(thing).get("__doc__") or "")
    written = text and not text.startswith(f"{thing.__name__}(")  # as dataclasses add
    return [" ".join(part.split()) for part in text.split("\n\n")] if written else []


def as_text(value: Any) -> str:
    """Return a value as a user writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(as_text, value)) + "]"
    if isinstance(value, float):
        return f"{value:g}" if math.isfinite(value) else "∞"
    return "" if value is None or value is ... else str(value)


def span(low: float, high: float) -> str:
    """Return a range; nothing if it has no ends."""
    if math.isfinite(low) and math.isfinite(high):
        return f"{low:g}…{high:g}"
    if math.isfinite(low):
        return f"≥ {low:g}"
    return f"≤ {high:g}" if math.isfinite(high) else ""
