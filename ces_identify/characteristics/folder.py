"""The folder of results: a CSV file for each table, and the page."""

from __future__ import annotations

from pathlib import Path

from ces_identify.characteristics.page import write_page
from ces_identify.characteristics.results import Characteristics
from ces_identify.characteristics.tables import write_tables

PAGE = "characteristics.html"


def write_characteristics(folder: str | Path, results: Characteristics, *, command: str = "") -> list[Path]:
    """Write the page and the tables into `folder`, which is made if it does not exist; return the files, page first.

    Files of an earlier run are replaced, each only when its new content is complete. `command` is shown on the page.
    """
    tables = write_tables(Path(folder), results)
    page = Path(folder) / PAGE
    write_page(page, results, command)
    return [page, *tables]
