"""The columns of the lists: for each kind of thing, what is shown of it and by what it is sorted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from ces_serve.files import item
from ces_serve.files.item import KINDS, Item

ALL = ""  # the list of all kinds


@dataclass(frozen=True)
class ListColumn:
    """A column: its key in a URL, heading, text of a cell, and the value to sort by (None comes last)."""

    key: str
    heading: str
    text: Callable[[Item], str]
    value: Callable[[Item], Any]
    numeric: bool = False
    falling: bool = False  # the first click sorts from the largest down


def columns_of(kind: str) -> tuple[ListColumn, ...]:
    """Return the columns after the name, for a list of one kind or of ALL."""
    return (*COLUMNS[kind], CHANGED)


def sort_items(items: Sequence[Item], key: str, columns: Sequence[ListColumn]) -> list[Item]:
    """Return the items sorted by the column `key`, falling if it begins with a minus; as they are if unknown."""
    column = next((one for one in columns if one.key == key.removeprefix("-")), None)
    if column is None:
        return list(items)
    known = [one for one in items if column.value(one) is not None]
    known.sort(key=column.value, reverse=key.startswith("-"))
    return known + [one for one in items if column.value(one) is None]


def format_time(time_s: float) -> str:
    """Return a local time to the minute, a dash if no calendar has it (a file may carry any time)."""
    try:
        return f"{datetime.fromtimestamp(time_s):%Y-%m-%d %H:%M}"
    except (ValueError, OverflowError, OSError):
        return "–"


def _fact(key: str, heading: str, form: str = "", scale: float = 1.0, falling: bool = False) -> ListColumn:
    """Return the column of a number in the facts, or of a text if `form` is empty."""

    def value(one: Item) -> Any:
        found = one.facts.get(key)
        return ", ".join(map(str, found)) if isinstance(found, list) else found

    def text(one: Item) -> str:
        found = value(one)
        if found is None:
            return "–"
        return format(found if scale == 1.0 else found * scale, form).replace("-", "−") if form else str(found)

    return ListColumn(key, heading, text, value, numeric=bool(form), falling=falling)


NAME = ListColumn("name", "name", lambda one: one.name, lambda one: one.path.lower())
CHANGED = ListColumn(
    "changed", "changed", lambda one: format_time(one.modified_s), lambda one: one.modified_s, falling=True
)
KIND = ListColumn("kind", "kind", lambda one: KINDS[one.kind][1].replace(" ", "\u00a0"), lambda one: one.kind)
SUMMARY = ListColumn("summary", "says", lambda one: one.summary, lambda one: one.summary.lower() or None)
PROOF = ListColumn(
    "proof",
    "stability",
    lambda one: str(one.facts["certificate"]).partition(":")[0],
    lambda one: str(one.facts["certificate"]),
)
COLUMNS: dict[str, tuple[ListColumn, ...]] = {
    ALL: (KIND, SUMMARY, _fact("cost_J", "J %", ".2f")),
    item.MODEL: (
        _fact("structure", "structure"),
        _fact("size", "size"),
        _fact("cost_J", "J % validation", ".2f"),
        _fact("fit_J", "J % identification", ".2f"),
        _fact("recordings", "identified on"),
        PROOF,
    ),
    item.REPORT: (_fact("title", "title"),),
    item.CAMPAIGN: (
        _fact("count", "models", "d", falling=True),
        _fact("failed", "failed", "d", falling=True),
        _fact("structures", "structures"),
        _fact("selection_J", "lowest selection J %", ".2f"),
    ),
    item.DIAGNOSIS: (
        _fact("verdict", "verdict"),
        _fact("effects", "effects"),
        _fact("gap_N", "gap N", ".1f", falling=True),
        _fact("after_N", "left N", ".1f", falling=True),
        _fact("simulation", "simulation"),
    ),
    item.FLEET: (
        _fact("count", "units", "d", falling=True),
        SUMMARY,
        _fact("largest_gap_N", "largest gap N", ".1f", falling=True),
    ),
    item.ITERATION: (
        _fact("count", "iterations", "d", falling=True),
        _fact("recorded_s", "recorded s", ".0f", falling=True),
        _fact("fresh_J", "J % fresh", ".2f"),
        _fact("fit_J", "J % fit", ".2f"),
        _fact("coverage", "covered %", ".0f", 100.0, falling=True),
    ),
    item.STROKE: (
        _fact("count", "runs learned", "d", falling=True),
        _fact("first_m", "error before mm", ".3f", 1e3, falling=True),
        _fact("confirmed_m", "error after mm", ".3f", 1e3),
        _fact("stopped", "stopped"),
    ),
    item.RECORDING: (
        _fact("seconds", "s", ".1f", falling=True),
        _fact("messages", "messages", "d", falling=True),
        _fact("bytes", "MB", ".1f", 1e-6, falling=True),
    ),
    item.UNREADABLE: (SUMMARY,),
}
