"""The tables as CSV files, one for each, with `columns.csv` that gives unit and meaning of every column."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import astuple
from pathlib import Path

from ces_identify.characteristics.results import TABLES, Characteristics
from ces_identify.characteristics.rows import columns
from ces_observer.json_checks import write_atomically

COLUMNS = "columns.csv"


def write_tables(folder: Path, characteristics: Characteristics) -> list[Path]:
    """Write the tables into `folder`, which is made if it does not exist; return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    described = [(table, *column) for table, row in TABLES.items() for column in columns(row)]
    texts = {f"{table}.csv": format_table(characteristics, table) for table in TABLES}
    texts[COLUMNS] = _as_csv(("table", "column", "unit", "meaning"), described)
    for name, text in texts.items():
        write_atomically(folder / name, text)
    return [folder / name for name in texts]


def format_table(characteristics: Characteristics, table: str) -> str:
    """Return one table as CSV; a missing value is an empty cell."""
    rows = (astuple(row) for row in getattr(characteristics, table))
    return _as_csv([name for name, _, _ in columns(TABLES[table])], rows)


def _as_csv(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows([_format_cell(value) for value in row] for row in rows)
    return text.getvalue()


def _format_cell(value: object) -> object:
    """Return a number with seven figures, and nothing for NaN."""
    if not isinstance(value, float):
        return value
    return f"{value:.7g}" if value == value else ""  # noqa: PLR0124 - NaN differs from itself
