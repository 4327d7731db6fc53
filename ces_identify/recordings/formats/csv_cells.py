"""Cells of text tables: numbers, the spellings of a number that is missing, and comments."""

from __future__ import annotations

import re
from collections.abc import Sequence

from ces_identify.recordings.formats.dates import is_date

GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}([.,'’ \u00a0\u202f]\d{3})+([.,]\d+)?$")  # 1.234,5 or 1'234.5
WHOLE_GROUPS = re.compile(r"[-+]?[1-9]\d{0,2}([.,]\d{3})+$")
MIN_MIXED = 3
COMMENT_MARKS = ("#", "%", "//")
MISSING = frozenset(
    (
        *("na", "n/a", "#n/a", "#na", "#nv", "null", "none", "nil", "missing", "nan(ind)", "-nan(ind)", "?"),
        *("-", "--", "---", "1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind", "1.#inf", "-1.#inf"),
        *("#div/0!", "#value!", "#wert!", "#num!", "#zahl!", "#ref!", "#bezug!"),
    )
)


def parse_number(cell: str, decimal: str) -> float:
    """Return the number in a cell; raises ValueError if it is none, as 1.234 with a decimal comma."""
    if decimal != "." and "." in cell:
        raise ValueError(cell)
    return float(cell.replace(decimal, "."))


def is_number(cell: str, decimal: str) -> bool:
    """Return whether a cell is a number."""
    try:
        parse_number(cell, decimal)
    except ValueError:
        return False
    return True


def is_grouped(cell: str) -> bool:
    """Return whether a cell is a number with thousands separators, or may be one."""
    return GROUPED.match(cell.strip()) is not None


def mixes_groups(cells: Sequence[str], decimal: str) -> bool:
    """Return whether whole numbers up to 999 stand beside 1.234, with three digits behind every mark: thousands."""
    marked = [cell.strip() for cell in cells if decimal in cell]
    whole = [cell.strip().lstrip("+-") for cell in cells if decimal not in cell and cell.strip()]
    return (
        min(len(marked), len(whole)) >= MIN_MIXED
        and all(WHOLE_GROUPS.match(cell) for cell in marked)
        and all(cell.isdecimal() and len(cell) <= 3 for cell in whole)
    )


def is_value(cell: str, decimal: str) -> bool:
    """Return whether a cell is what a row of numbers has: a number in any spelling, a date, or none that is missing."""
    known = is_number(cell, decimal) or is_date(cell) or is_grouped(cell)
    return known or not cell.strip() or is_missing(cell)


def is_missing(cell: str) -> bool:
    """Return whether a cell is one of the ways in which programs write that there is no number."""
    return cell.strip().casefold() in MISSING


def is_comment(cells: Sequence[str]) -> bool:
    """Return whether a line is a comment, by the mark with which it begins."""
    first = cells[0].lstrip() if cells else ""
    return first.startswith(COMMENT_MARKS) and not is_missing(first)
