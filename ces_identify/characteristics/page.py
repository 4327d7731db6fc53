"""The results as files: the page with charts and tables, measured beside simulated, and a CSV file for each table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ces_identify.characteristics.charts import (
    Palette,
    choose_test_points,
    current_chart,
    family_chart,
    loop_charts,
    motion_charts,
    peak_chart,
    range_chart,
    response_charts,
    work_chart,
)
from ces_identify.characteristics.rows import TABLES, Characteristics
from ces_identify.characteristics.rules import list_rules
from ces_identify.characteristics.tables import (
    choose_rows,
    current_table,
    judged_table,
    omission_table,
    peak_table,
    range_table,
    recording_table,
    response_table,
    width_table,
    work_table,
    zero_speed_table,
)
from ces_identify.characteristics.workbook import write_figures, write_workbook
from ces_observer.json_text import write_atomically
from ces_report.plot import Plot, draw_plot, share_points
from ces_report.shell import PageHead, page_template, replace_unencodable
from ces_report.table import Table, as_csv, row_fields, rows_as_csv, summarize_result
from ces_report.typesetting import format_decimal, join_names

PAGE, COLUMNS, RULES = "characteristics.html", "columns.csv", "rules.csv"


def write_characteristics(folder: str | Path, results: Characteristics, head: PageHead) -> list[Path]:
    """Write the page and the tables into `folder`, which is made if it does not exist; return the files, page first.

    A workbook and figures follow if their packages are installed, see `missing_packages`. Files of an earlier run are
    replaced, each only when its new content is complete.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    texts = {f"{table}.csv": rows_as_csv(row, getattr(results, table)) for table, row in TABLES.items()}
    fields = [(table, field) for table, row in TABLES.items() for field in row_fields(row).values()]
    described = [(table, field.name, field.unit, field.meaning) for table, field in fields]
    texts[COLUMNS] = as_csv([("table", "column", "unit", "meaning"), *described])
    texts[RULES] = as_csv([("key", "value", "unit", "meaning"), *list_rules(results.rules)])
    for name, text in texts.items():
        write_atomically(folder / name, text)
    plots = make_plots(results)
    write_atomically(folder / PAGE, format_page(results, head, plots))
    extras = [
        *write_workbook(folder, results, head),
        *write_figures(folder, [p for some in plots.values() for p in some]),
    ]
    return [*(folder / name for name in (PAGE, *texts)), *extras]


def make_plots(results: Characteristics) -> dict[str, list[Plot]]:
    """Return the charts of the page by section; those of loops are in pairs."""
    palette = Palette(results.sources, tuple(sorted({row.current_A for row in results.peak_velocity})))
    points = enumerate(choose_test_points(results))
    return {
        "family": [family_chart(results)] if results.speed_bins else [],
        "peaks": [peak_chart(results, palette), work_chart(results, palette)] if results.peak_velocity else [],
        "currents": [current_chart(results), range_chart(results)] if results.ranges else [],
        "loops": [plot for n, point in points for plot in loop_charts(results, palette, n, point)],
        "responses": list(response_charts(results)),
        "motions": list(motion_charts(results)),
    }


def format_page(results: Characteristics, head: PageHead, plots: Mapping[str, Sequence[Plot]]) -> str:
    """Return the page as self-contained HTML."""
    limit = share_points(sum(len(area.marks) for some in plots.values() for plot in some for area in plot.areas))
    drawn = {name: [(draw_plot(plot, limit), plot.title) for plot in some] for name, some in plots.items()}
    loops = drawn.pop("loops")
    beside = f" beside {join_names(results.sources[1:])}" if len(results.sources) > 1 else ""
    long_tables = (peak_table, current_table, work_table, zero_speed_table, width_table)
    short_tables = (range_table, judged_table, response_table, recording_table, omission_table)
    page = page_template("characteristics.html.j2", "ces_identify.characteristics", ("characteristics.css",)).render(
        head=head.titled(f"Characteristics: {join_names([r.name for r in results.recordings])}{beside}"),
        results=results,
        simulations=results.sources[1:],
        tolerance=format_decimal(results.current_tolerance_A),
        loops=list(zip(loops[::2], loops[1::2], strict=True)),
        **drawn,
        **{make.__name__: choose_rows(make(results)) for make in long_tables},
        **{make.__name__: make(results) for make in short_tables},
    )
    return replace_unencodable(page)


@summarize_result.register
def _(results: Characteristics) -> tuple[Sequence[str], Table[Any]]:
    used, total = (sum(getattr(r, name) for r in results.recordings) for name in ("cycles_used", "cycles"))
    about = f"{join_names([r.name for r in results.recordings])}: {used} of {total} cycles repeat at a constant current"
    reasons = [f"{row.subject}: {row.reason}" for row in results.omissions if row.recording == "all"]
    return [about, *reasons], choose_rows(peak_table(results))
