"""The results as files: the page with charts and tables, measured beside simulated, and a CSV file for each table.

Tables of the page and of the terminal have the measured rows, and each simulation beside them. They are
a workbook, too, a sheet each with the rules and sources before them, and the charts are pictures. Both need packages
beyond those of the tools; without them nothing is written, see `missing_packages`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, replace
from importlib import import_module, resources
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

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
from ces_identify.characteristics.cycles import SHARES
from ces_identify.characteristics.motion import MEASURED
from ces_identify.characteristics.rows import (
    TABLES,
    Characteristics,
    ConditionRow,
    ContinuousForce,
    ControlRange,
    CurrentForce,
    CycleWork,
    JudgedValue,
    Omission,
    PeakForce,
    RecordingFacts,
    ValveResponse,
)
from ces_identify.characteristics.rules import list_rules
from ces_observer.json_text import write_atomically
from ces_report.figure import Plot, PlotArea, PlotBand, PlotDots, PlotLine
from ces_report.plot import draw_plot, share_points
from ces_report.shell import PageHead, page_template, replace_unencodable
from ces_report.table import Column, Table, as_csv, columns_of, row_fields, rows_as_csv, summarize_result
from ces_report.typesetting import format_decimal, join_names

MAX_ROWS = 60  # of a table on the page, about; the CSV file has all
WIDTH_SHARES = {0.25: "Width at 25\N{NO-BREAK SPACE}% of the peak speed [N]", 0.5: "at 50\N{NO-BREAK SPACE}%"}
WIDTH_SHARES |= {0.75: "at 75\N{NO-BREAK SPACE}%"}  # at which the page shows the hysteresis
MISSING = "–"
CONDITION = ("current_A", "amplitude_m", "frequency_Hz", "cycles")
OneRow = TypeVar("OneRow", bound=ConditionRow | ControlRange)


def peak_table(results: Characteristics) -> Table[PeakForce]:
    """Return a row for each condition and direction: measured force, and each simulation's with its difference."""
    corrected = ("raw_N",) if results.rules.gas_force_N else ()
    columns = columns_of(PeakForce, *CONDITION, "direction", "speed_m_s", "force_N", *corrected)
    columns += _list_simulated(results, results.peak_velocity, "force_N", "difference_N")
    title = f"{results.rules.force_sentence} \N{PLUS-MINUS SIGN}: standard deviation between cycles."
    return Table(columns, _select_measured(results.peak_velocity), title)


def range_table(results: Characteristics) -> Table[ControlRange]:
    """Return a row for each speed and direction: what the valve can do, and each simulation's range."""
    names = ["direction", "speed_m_s", "soft_A", "hard_A", "soft_N", "hard_N", "range_N", "ratio"]
    names += ["hysteresis_N"] * _has_branches(results)
    columns = columns_of(ControlRange, *names)
    columns += _list_simulated(results, results.ranges, "range_N", "difference_N")
    title = "Range from the softest to the hardest current (± half the 95 % interval)."
    return Table(columns, _select_measured(results.ranges), title)


def current_table(results: Characteristics) -> Table[CurrentForce]:
    """Return a row for each speed, direction and current: linearity, and hysteresis between the branches."""
    columns = columns_of(CurrentForce, "direction", "speed_m_s", "current_A", "cycles", "force_N", "linearity")
    if _has_branches(results):
        columns += columns_of(CurrentForce, "raised_N", "lowered_N", "width_N", "width_share")
    columns += _list_simulated(results, results.over_current, "force_N", "difference_N")
    return Table(columns, _select_measured(results.over_current))


def _has_branches(results: Characteristics) -> bool:
    """Return whether some current was reached from both sides."""
    return any(not math.isnan(row.width_N) for row in results.over_current)


def judged_table(results: Characteristics) -> Table[JudgedValue]:
    """Return a row for each value that a limit of the rules is for."""
    return Table(columns_of(JudgedValue), results.judged, "Limits of the rules")


def work_table(results: Characteristics) -> Table[CycleWork]:
    """Return a row for each condition: measured work, and each simulation's with its difference, or what it implies."""
    alone = len(results.sources) == 1  # in a terminal there is room for one or the other
    implied = columns_of(CycleWork, "damping_Ns_m", "zero_width_N", "rebound_ratio")
    implied[1] = replace(implied[1], terminal_only=True)  # a table of its own on pages
    columns = columns_of(CycleWork, *CONDITION, "work_J")
    columns += _list_simulated(results, results.work, "work_J", "difference_J")
    columns += implied if alone else [replace(column, page_only=True) for column in implied[::2]]
    others = ", equivalent damping, hysteresis at zero speed, rebound over compression" if alone else ""
    return Table(columns, _select_measured(results.work), f"Work per cycle{others}.")


def zero_speed_table(results: Characteristics) -> Table[CycleWork]:
    """Return a row for each condition: the measured forces at zero speed."""
    columns = columns_of(CycleWork, *CONDITION, "zero_width_N", "zero_width_per_ms_N", "mid_force_N")
    return Table(columns, _select_measured(results.work))


def width_table(results: Characteristics) -> Table[tuple[ContinuousForce, ...]]:
    """Return the hysteresis width at WIDTH_SHARES of the peak speed; a row is a curve: its points at all SHARES."""
    size, rows = len(SHARES), results.continuous
    at = {share: int(abs(SHARES - share).argmin()) for share in WIDTH_SHARES}
    (width, force) = columns_of(ContinuousForce, "width_N", "force_N")
    columns = [_of_point(0, column) for column in columns_of(ContinuousForce, *CONDITION, "source", "direction")]
    columns += [_of_point(at[share], replace(width, heading=heading)) for share, heading in WIDTH_SHARES.items()]
    columns.append(_of_point(at[0.5], replace(force, heading="Force at 50\N{NO-BREAK SPACE}% [N]")))
    return Table(columns, [rows[k : k + size] for k in range(0, len(rows), size)])


def response_table(results: Characteristics) -> Table[ValveResponse]:
    """Return a row for each kind of step and source, times in ms."""
    names = ("from_A", "to_A", "change", "direction", "source", "steps", "speed_m_s", "force_change_N")
    times = ("dead_time_s", "time_constant_s", "time_63_s", "time_90_s", "rise_s", "settled_s", "overshoot", "dips")
    title = f"Response of the valve. {results.rules.step_sentence} \N{PLUS-MINUS SIGN}: half the 95 % interval."
    return Table(columns_of(ValveResponse, *names, *times), results.responses, title)


def recording_table(results: Characteristics) -> Table[RecordingFacts]:
    """Return a row for each recording: what the results rest on."""
    return Table(columns_of(RecordingFacts), results.recordings)


def omission_table(results: Characteristics) -> Table[Omission]:
    """Return a row for each reason why something in a recording was not used."""
    return Table(columns_of(Omission), [omission for omission in results.omissions if omission.recording != "all"])


def choose_rows(table: Table[Any]) -> Table[Any]:
    """Return a table for the page: of many rows, those of evenly chosen conditions of each current."""
    conditions: dict[float, dict[tuple[float, float], list[Any]]] = {}
    for row in table.rows:
        point = row[0] if isinstance(row, tuple) else row
        of_current = conditions.setdefault(point.current_A, {})
        of_current.setdefault((point.amplitude_m, point.frequency_Hz), []).append(row)
    every = max(1, math.ceil(len(table.rows) / MAX_ROWS))
    shown = [row for own in conditions.values() for some in list(own.values())[::every] for row in some]
    return replace(table, rows=shown, left_out=len(table.rows) - len(shown))


def _of_point(number: int, column: Column[Any]) -> Column[Any]:
    """Return a column of one point of a curve."""
    return replace(column, text=lambda curve: column.text(curve[number]))


def _select_measured(rows: Sequence[OneRow]) -> list[OneRow]:
    return [row for row in rows if row.source == MEASURED]


def _list_simulated(results: Characteristics, rows: Sequence[Any], *names: str) -> list[Column[Any]]:
    """Return each simulation's value and difference; a terminal has room for the values of one simulation only."""

    def condition(row: Any) -> tuple[Any, ...]:
        return getattr(row, "current_A", 0.0), row.amplitude_m, row.frequency_Hz, getattr(row, "direction", "")

    def of_source(source: str, column: Column[Any]) -> Column[Any]:
        same = {condition(row): row for row in rows if row.source == source}
        return replace(column, text=lambda row: column.text(same[key]) if (key := condition(row)) in same else MISSING)

    columns, several = [], len(results.sources) > 2
    for source in results.sources[1:] if rows else ():
        value, difference = (row_fields(type(rows[0]))[name] for name in names)
        value = replace(value, heading=source, short="" if several else source, spread="")
        difference = replace(difference, short=f"{source} difference" if several else "difference")
        columns += [of_source(source, replace(value.column, head_css="as-is")), of_source(source, difference.column)]
    return columns


WORKBOOK, FIGURES = "characteristics.xlsx", "figures"
PACKAGES = ("openpyxl", "matplotlib")
DPI = 300
PIXELS = 100.0  # of a chart to the inch
UNPRINTABLE = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f]")  # which XML cannot hold
OF_FORCES = ("peak_velocity", "over_current", "ranges")
OF_STEPS = ("responses", "response_points", "steps")


def missing_packages() -> str:
    """Return which packages of workbook and figures are not installed, as one line with what to do; else nothing."""
    missing = [name for name in PACKAGES if find_spec(name) is None]
    what = {"openpyxl": f"no {WORKBOOK}", "matplotlib": "no pictures of the charts"}
    words = " and ".join(f"{what[name]} ({name} is not installed)" for name in missing)
    return f"{words}: pip install 'ces_observer[workbook]'" if missing else ""


def write_workbook(folder: Path, results: Characteristics, head: PageHead) -> list[Path]:
    """Write the workbook, settings and sources first; return its path, or nothing without openpyxl."""
    if find_spec("openpyxl") is None:
        return []
    book = import_module("openpyxl").Workbook()
    book.remove(book.active)
    rules = results.rules
    settings = [("key", "value", "unit", "meaning"), *list_rules(rules), (), ("command", head.command)]
    _add_sheet(book, "settings", settings)
    facts = [astuple(one) for one in results.recordings]
    _add_sheet(book, "sources", [*_heads(RecordingFacts), *facts, (), ("forces", *results.sources)])
    for name, row in TABLES.items():
        said = rules.force_sentence if name in OF_FORCES else rules.step_sentence if name in OF_STEPS else ""
        _add_sheet(book, name, [*([(said,)] if said else []), *_heads(row), *map(astuple, getattr(results, name))])
    part = folder / f".{WORKBOOK}.part"
    book.save(part)
    return [part.replace(folder / WORKBOOK)]


def _heads(row: Any) -> list[tuple[str, ...]]:
    """Return names and units of the columns of a row type."""
    fields = row_fields(row).values()
    return [tuple(one.name for one in fields), tuple(one.unit for one in fields)]


def _add_sheet(book: Any, name: str, rows: Iterable[Sequence[object]]) -> None:
    """Add a sheet; a text is never a formula."""
    sheet = book.create_sheet(name)
    sheet.sheet_format.defaultColWidth = 16  # letters
    for number, row in enumerate(rows, 1):
        for column, value in enumerate(row, 1):
            if isinstance(value, float) and not math.isfinite(value):
                continue
            text = isinstance(value, str)
            cell = sheet.cell(number, column, UNPRINTABLE.sub(" ", str(value)) if text else value)
            cell.data_type = "s" if text else cell.data_type


def write_figures(folder: Path, plots: Sequence[Plot]) -> list[Path]:
    """Write each chart as PNG into the folder of figures; return the paths, none without matplotlib."""
    if find_spec("matplotlib") is None:
        return []
    (folder / FIGURES).mkdir(exist_ok=True)
    colours = dict(
        re.findall(r"--(\w+-?\d?): (#\w+)", resources.files("ces_report").joinpath("report.css").read_text())
    )
    return [_write_figure(folder / FIGURES / f"{plot.ident}.png", plot, colours) for plot in plots]


def _write_figure(path: Path, plot: Plot, colours: dict[str, str]) -> Path:
    heights = [area.height for area in plot.areas]
    size = plot.width / PIXELS, (sum(heights) + 110.0) / PIXELS
    figure = import_module("matplotlib.figure").Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(heights), 1, squeeze=False, sharex=True, height_ratios=heights)[:, 0]
    for axes, area in zip(panels, plot.areas, strict=True):
        _draw_area(axes, area, colours)
    panels[0].set_title(plot.title, fontsize=10)
    panels[-1].set_xlabel(plot.x_label)
    figure.savefig(path, dpi=DPI)
    return path


def _draw_area(axes: Any, area: PlotArea, colours: dict[str, str]) -> None:
    seen: set[str] = set()
    for mark in area.marks:
        name, colour = ("" if mark.name in seen else mark.name), _colour_of(mark.css, colours)
        seen.add(mark.name)
        if isinstance(mark, PlotBand):
            axes.fill_between(mark.x, mark.low, mark.high, color=colour, alpha=0.2, linewidth=0.0, label=name)
        elif isinstance(mark, PlotDots):
            axes.plot(mark.x, mark.y, "o", color=colour, markersize=3.0, label=name)
        elif isinstance(mark, PlotLine):
            axes.plot(mark.x, mark.y, "--" if "beyond" in mark.css else "-", color=colour, linewidth=1.2, label=name)
    axes.set_ylabel(area.y_label)
    axes.grid(alpha=0.3)
    if area.y_range is not None:
        axes.set_ylim(area.y_range)
    if seen:
        axes.legend(fontsize=6, ncols=2)


def _colour_of(css: str, colours: dict[str, str]) -> Any:
    """Return the colour of a mark's classes, that of the style sheet for light paper; half shades are in between."""
    number = next((word for word in css.split() if re.fullmatch(r"[cs]\d", word)), "")
    if not number:
        return colours["measured"]
    kind, n = ("curve" if number[0] == "c" else "series"), int(number[1])
    rgb = [np.array([int(colours[f"{kind}-{k}"][i : i + 2], 16) for i in (1, 3, 5)]) for k in (n, min(n + 1, 3))]
    return tuple((0.5 * (rgb[0] + rgb[1]) if "half" in css.split() else rgb[0]) / 255.0)


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
