"""Charts to work with: a `Plot` goes in, a self-contained figure with its legend, data and table comes out.

Python draws the figure as SVG, which prints and needs no script. The data follow as compact JSON, from which the one
script of the page (`plots.js`) redraws the figure when the reader zooms, moves or hides lines, and reads values out.
"""

from __future__ import annotations

from markupsafe import Markup

from ces_identify.report.plot_data import MAX_POINTS, pack, share_points
from ces_identify.report.plot_marks import (
    Plot,
    PlotArea,
    PlotBand,
    PlotBars,
    PlotDots,
    PlotLine,
    PlotMark,
    PlotShade,
    curve_css,
    series_css,
)
from ces_identify.report.plot_svg import draw_svg, lay_out
from ces_identify.report.plot_table import plot_table

__all__ = [
    "Plot",
    "PlotArea",
    "PlotBand",
    "PlotBars",
    "PlotDots",
    "PlotLine",
    "PlotMark",
    "PlotShade",
    "curve_css",
    "draw_plot",
    "series_css",
    "share_points",
]

SWATCHES = {"line": "M1,5h20", "dots": "M5,5h0M11,5h0M17,5h0"}


def draw_plot(plot: Plot, max_points: int = MAX_POINTS, table: Markup | None = None) -> Markup:
    """Return a plot as HTML: legend, figure, data and a table of the values that it shows, or the given `table`.

    Lines with more than `max_points` points keep the lowest and the highest value of groups of samples in the data,
    and the plot says so; see `share_points` for pages with many lines.
    """
    panels = lay_out(plot)
    packed = pack(plot, panels, max_points)
    group = Markup(' data-group="{}"').format(plot.group) if plot.group else Markup("")
    return Markup('<div class="plot" id="{}-plot"{}>{}{}{}{}<script type="application/json">{}</script></div>').format(
        plot.ident,
        group,
        _legend(plot) if plot.legend else "",
        draw_svg(plot, panels),
        _resolution(packed.samples),
        plot_table(plot) if table is None else table,
        Markup(packed.text),  # JSON with <, > and & as escape sequences
    )


def _legend(plot: Plot) -> Markup:
    """Return a list of the names of all marks, each with the swatch of the first mark of this name."""
    first: dict[str, PlotMark] = {}
    for mark in (mark for area in plot.areas for mark in area.marks if mark.name):
        first.setdefault(mark.name, mark)
    entries = Markup("").join(
        Markup('<li data-name="{}">{}{}</li>').format(name, _swatch(mark), name) for name, mark in first.items()
    )
    return Markup('<ul class="plot-legend">{}</ul>').format(entries) if entries else Markup("")


def _swatch(mark: PlotMark) -> Markup:
    """Return a small picture of how a mark is drawn."""
    if isinstance(mark, PlotBars | PlotShade):
        inner = Markup('<rect class="{}" x="1" y="0" width="20" height="10"/>').format(mark.css)
    elif isinstance(mark, PlotBand):
        inner = Markup('<path class="{} area" d="M1,0h20v10h-20Z"/>').format(mark.css)
    else:
        kind = "dots" if {"dots", "spot"} & set(mark.css.split()) else "line"
        inner = Markup('<path class="{}" d="{}"/>').format(mark.css, SWATCHES[kind])
    return Markup('<svg class="plot-swatch" viewBox="0 0 22 10" aria-hidden="true">{}</svg>').format(inner)


def _resolution(samples: int) -> Markup:
    if samples == 1:
        return Markup("")
    return Markup('<p class="plot-resolution">Data of this chart: lowest and highest of every {} samples.</p>').format(
        samples
    )
