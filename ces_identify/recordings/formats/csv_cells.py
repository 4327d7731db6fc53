"""Cells of text tables: numbers, the spellings of a number that is missing, and comments."""

from __future__ import annotations

from collections.abc import Sequence

COMMENT_MARKS = ("#", "%", "//")
MISSING = frozenset(
    (
        *("na", "n/a", "#n/a", "#na", "#nv", "null", "none", "nil", "missing", "nan(ind)", "-nan(ind)", "?"),
        *("-", "--", "---", "1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind", "1.#inf", "-1.#inf"),
        *("#div/0!", "#value!", "#wert!", "#num!", "#zahl!", "#ref!", "#bezug!"),
    )
)


def is_number(cell: str, decimal: str) -> bool:
    """Return whether a cell is a number."""
    try:
        float(cell.replace(decimal, "."))
    except ValueError:
        return False
    return True


def is_missing(cell: str) -> bool:
    """Return whether a cell is one of the ways in which programs write that there is no number."""
    return cell.strip().casefold() in MISSING


def is_comment(cells: Sequence[str]) -> bool:
    """Return whether a line is a comment, by the mark with which it begins."""
    first = cells[0].lstrip() if cells else ""
    return first.startswith(COMMENT_MARKS) and not is_missing(first)
