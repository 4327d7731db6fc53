"""The tables as a workbook, a sheet each with the rules and sources before them, and the charts as pictures.

Both need packages beyond those of the tools; without them nothing is written, see `missing_packages`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import astuple
from importlib import import_module, resources
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ces_identify.characteristics.rows import TABLES, Characteristics, RecordingFacts
from ces_identify.characteristics.rules import list_rules
from ces_report.figure import Plot, PlotArea, PlotBand, PlotDots, PlotLine
from ces_report.shell import PageHead
from ces_report.table import row_fields

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
