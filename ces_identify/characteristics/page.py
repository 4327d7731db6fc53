"""The results as files: the page with charts and tables, measured beside simulated, and a CSV file for each table.

`columns.csv` gives unit and meaning of every column.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import astuple
from pathlib import Path

from markupsafe import Markup

from ces_identify.characteristics import tables
from ces_identify.characteristics.cycles import DIRECTIONS
from ces_identify.characteristics.page_charts import (
    choose_test_points,
    loop_charts,
    make_palette,
    motion_charts,
    peak_chart,
    response_chart,
    work_chart,
)
from ces_identify.characteristics.rows import TABLES, Characteristics, columns
from ces_observer.json_text import write_atomically
from ces_report.plot import Plot, draw_plot, share_points
from ces_report.shell import command_block, page_template, replace_unencodable
from ces_report.typesetting import join_names

PAGE, COLUMNS = "characteristics.html", "columns.csv"
MAX_OPEN_ROWS = 20  # of a table that is not folded


def write_characteristics(folder: str | Path, results: Characteristics, *, command: str = "") -> list[Path]:
    """Write the page and the tables into `folder`, which is made if it does not exist; return the files, page first.

    Files of an earlier run are replaced, each only when its new content is complete. `command` is shown on the page.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    texts = {f"{table}.csv": format_table(results, table) for table in TABLES}
    described = [(table, *column) for table, row in TABLES.items() for column in columns(row)]
    texts[COLUMNS] = _as_csv(("table", "column", "unit", "meaning"), described)
    for name, text in texts.items():
        write_atomically(folder / name, text)
    write_atomically(folder / PAGE, format_page(results, command))
    return [folder / name for name in (PAGE, *texts)]


def format_page(results: Characteristics, command: str = "") -> str:
    """Return the page as self-contained HTML."""
    palette, points = make_palette(results), choose_test_points(results)
    loops = [loop_charts(results, palette, n, point) for n, point in enumerate(points)]
    responses = [chart for d in DIRECTIONS if (chart := response_chart(results, d, palette)) is not None]
    motions = list(motion_charts(results))
    peaks = [peak_chart(results, palette), work_chart(results, palette)] if results.peak_velocity else []
    plots = [*peaks, *(plot for pair in loops for plot in pair), *responses, *motions]
    limit = share_points(sum(len(area.marks) for plot in plots for area in plot.areas))

    def draw(some: Sequence[Plot]) -> list[tuple[Markup, str]]:
        return [(draw_plot(plot, limit), plot.title) for plot in some]

    beside = f" beside {join_names(results.sources[1:])}" if len(results.sources) > 1 else ""
    page = page_template("characteristics.html.j2", "ces_identify.characteristics", ("characteristics.css",)).render(
        title=f"Characteristics: {join_names([r.name for r in results.recordings])}{beside}",
        command=command_block(command) if command else "",
        results=results,
        simulations=results.sources[1:],
        tolerance=tables.number(results.current_tolerance_A),
        peaks=draw(peaks),
        loops=[draw(pair) for pair in loops],
        responses=draw(responses),
        motions=draw(motions),
        peak_table=tables.choose_rows(tables.peak_table(results)),
        work_table=tables.choose_rows(tables.work_table(results)),
        zero_speed_table=tables.choose_rows(tables.zero_speed_table(results)),
        width_table=tables.choose_rows(tables.width_table(results)),
        knee_table=tables.choose_rows(tables.knee_table(results)),
        response_table=tables.response_table(results),
        recording_table=tables.recording_table(results),
        omission_table=tables.omission_table(results),
        fold=MAX_OPEN_ROWS,
    )
    return replace_unencodable(page)


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
