"""The rows of a fleet as a table for the terminal and as CSV, largest gap first."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from ces_cli.terminal.terminal import as_csv, make_table
from ces_identify.jobs.job import DONE
from ces_identify.jobs.row_log import Row
from ces_observer.json_checks import write_atomically

MAX_ROWS_SHOWN = 60
COLUMNS = (
    "name status verdict effects cause probability gap_N gap_low_N gap_high_N noise_floor_N cost_J "
    "gap_after_N shrink shrink_low shrink_high sentence notes recordings folder seconds reason key"
)


def sort_rows(rows: Sequence[Row]) -> list[Row]:
    """Return the rows with the largest gap first, those without a diagnosis last."""
    return sorted(rows, key=lambda row: (row["status"] != DONE, -(row.get("gap_N") or 0.0), row["name"]))


def describe_diagnosis(row: Row) -> str:
    """Return the result of a diagnosis in a few words."""
    if row["status"] != DONE:
        return f"{row['name']}: {row['status']}: {row['reason']}"
    return f"{row['name']}: {verdict_text(row)}, gap {format_number(row['gap_N'], '.1f')} N, {row['seconds']:.1f} s"


def verdict_text(row: Row) -> str:
    """Return the verdict with the effects that it names."""
    effects = " + ".join(effect.replace("_", " ") for effect in row["effects"])
    verdict = str(row["verdict"]).replace("_", " ")
    return f"{verdict}: {effects}" if effects else verdict


def shrink_text(row: Row) -> str:
    """Return by how much the named effects shrink the gap, a dash if there are none."""
    return "-" if row["shrink"] is None or not row["effects"] else f"{100.0 * row['shrink']:.0f} %"


def format_number(value: float | None, form: str) -> str:
    """Return a number as text, a dash if there is none."""
    return "-" if value is None else format(value, form)


def explain_dashes(rows: Sequence[Row]) -> str:
    """Return why rows have a dash instead of a figure, nothing if none has one."""
    done = [row for row in rows if row["status"] == DONE]
    unnamed = any(not row["effects"] or row["probability"] is None for row in done)
    unknown = any(row["gap_N"] is None or row["gap_after_N"] is None for row in done)
    texts = ["no effect was named, so there is no probability or shrink"] * unnamed
    texts += ["the gap could not be computed from these recordings"] * unknown
    return f"-: {'; or '.join(texts)}." if texts else ""


def fleet_table(rows: Sequence[Row]) -> Table:
    """Return a table of the diagnoses for the terminal."""
    done = [row for row in sort_rows(rows) if row["status"] == DONE]
    title = f"{len(done)} of {len(rows)} diagnosed" + ("; the largest gaps" if len(done) > MAX_ROWS_SHOWN else "")
    table = make_table(title, ("vehicle or recording", "verdict"), ("P", "gap N", "after N", "shrink"))
    for row in done[:MAX_ROWS_SHOWN]:
        gaps = (format_number(row["gap_N"], ".1f"), format_number(row["gap_after_N"], ".1f"))
        names = (escape(row["name"]), verdict_text(row))
        table.add_row(*names, format_number(row["probability"], ".2f"), *gaps, shrink_text(row))
    return table


def write_csv(rows: Sequence[Row], path: Path) -> None:
    """Write a line for each row, with lists joined by ` + `."""
    columns = COLUMNS.split()
    lines = [[_cell(row.get(name)) for name in columns] for row in sort_rows(rows)]
    write_atomically(path, as_csv([columns, *lines]))


def _cell(value: object) -> object:
    return " + ".join(map(str, value)) if isinstance(value, list) else value
