"""What a chart shows: lines, dots, bands and shades in areas over one x axis."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from ces_report.drawing import F, Mask, Panel, around_zero, axes, between, dots, line, note, panel, span_of, svg

MAX_ENTRIES = 8  # of a legend
SERIES = 8  # classes s0 to s7: colours of things that have no order
CURVES = 4  # classes c0 to c3: colours that rise with their order, such as currents
LEFT, RIGHT, TOP = 62.0, 16.0, 26.0  # [px] around the areas
COLUMN_LEFT = 46.0  # [px] before an area, where there are several columns
BETWEEN, X_AXIS = 34.0, 41.0  # [px] above an area for its name, and below one for the labels of its x axis
NO_DATA = "no values"


@dataclass(frozen=True)
class PlotLine:
    """A line through the finite points of y (n,) over x (n,), interrupted before each point where `breaks` is true.

    `name` is the entry in the legend (none if empty); marks of the same name are shown and hidden together. `css` are
    classes of the style sheet, never colours. A line through points that are not in the order of x needs a plot with
    `free` axes. Where a legend shows a scale, it names the `group` in place of each mark.
    """

    name: str
    x: F
    y: F
    css: str = "measured"
    breaks: Mask | None = None
    group: str = ""


@dataclass(frozen=True)
class PlotDots:
    """A dot at each finite point of y (n,) over x (n,); `css` ends with `dots`, or with `spot` for larger ones."""

    name: str
    x: F
    y: F
    css: str = "measured dots"
    group: str = ""


@dataclass(frozen=True)
class PlotBand:
    """The area between `low` and `high` (n,) over x (n,) in its order; without a name its values are not read out."""

    name: str
    x: F
    low: F
    high: F
    css: str = "bounds"


@dataclass(frozen=True)
class PlotShade:
    """A shade over the whole height where `mask` (n,) is true at x (n,) in its order."""

    name: str
    x: F
    mask: Mask
    css: str = "outside"

    def spans(self, room: float = 0.0) -> F:
        """Return the ranges of x (m, 2) where the mask is true; those that are no more than `room` apart are one."""
        ends = np.flatnonzero(np.diff(np.concatenate([[False], self.mask, [False]]).astype(np.int8)))
        first, last = self.x[ends[::2]], self.x[ends[1::2] - 1]
        apart = np.concatenate([[True], first[1:] - last[:-1] > room])[: len(first)]
        kept = np.append(np.flatnonzero(apart), len(first))
        return np.stack([first[kept[:-1]], last[kept[1:] - 1]], axis=1)


PlotMark = PlotLine | PlotDots | PlotBand | PlotShade


@dataclass(frozen=True)
class PlotArea:
    """Marks over the common x axis of a plot, drawn in their order, with a y axis named `y_label`, such as Force [N].

    `y_range` None shows all finite values; `around_zero` makes the axis symmetric with three labels. An area with
    `whole` always shows all data and the window of the other areas in it, which the reader can move.
    """

    y_label: str
    marks: Sequence[PlotMark]
    height: float = 170.0
    y_range: tuple[float, float] | None = None
    around_zero: bool = False
    y_ticks: int = 5
    whole: bool = False


@dataclass(frozen=True)
class PlotScale:
    """The colours of marks that rise in an order, such as currents: style-sheet classes from `low` to `high`."""

    styles: Sequence[str]
    low: str
    high: str


@dataclass(frozen=True)
class Plot:
    """A chart: areas below each other; `title` and `text` are its accessible name and its description in a sentence.

    `ident` must be unique in the page. `x_view` is the range of x that is shown at first and in print, None for all.
    Charts of one `group` zoom, move and read values together. `free`: zoom works on both axes, and values are read at
    the nearest point (speed-force clouds, loops); otherwise zoom works on x, and y follows what is visible.
    Areas fill `columns` row by row. A legend of more than MAX_ENTRIES names shows the `scale` and the groups of marks.
    """

    ident: str
    title: str
    text: str
    x_label: str
    areas: Sequence[PlotArea]
    width: float = 660.0
    x_view: tuple[float, float] | None = None
    group: str = ""
    free: bool = False
    x_ticks: int = 8
    legend: bool = True
    columns: int = 1
    scale: PlotScale | None = None


def series_css(number: int) -> str:
    """Return the classes of the line `number` (from 0) among things without an order; they repeat after SERIES."""
    return f"series s{number % SERIES}"


def curve_css(number: int, count: int) -> str:
    """Return the classes of the curve `number` of `count` that rise in their order, such as currents."""
    return f"curve c{round(number * (CURVES - 1) / (count - 1)) if count > 1 else CURVES - 3}"


def draw_svg(plot: Plot, panels: Sequence[Panel]) -> Markup:
    """Return the figure of a plot in `panels`, one for each area."""
    parts = []
    for number, (area, p) in enumerate(zip(plot.areas, panels, strict=True)):
        box = f'x="{p.x.start - 3:.1f}" y="{p.y.stop - 3:.1f}" width="{p.x.stop - p.x.start + 6:.1f}"'
        box += f' height="{p.y.start - p.y.stop + 6:.1f}"'
        parts.append(f'<clipPath id="{plot.ident}-clip{number}"><rect {box}/></clipPath>')
        empty = not any(np.isfinite(values).any() for values in _values(area.marks, (-np.inf, np.inf)))
        x_label, y_ticks = plot.x_label if has_x_axis(plot, number) else "", None if area.around_zero else area.y_ticks
        frame = axes(p, x_label, area.y_label, plot.x_ticks, 0 if empty else y_ticks, find_name_x(plot, p))
        parts.append(f'<g class="area">{frame}{note(p, NO_DATA) if empty else ""}')
        marks = [draw_mark(p, mark) for mark in area.marks]
        if area.whole and plot.x_view is not None:
            marks.append(p.rect(*plot.x_view, "window"))
        parts.append(f'<g clip-path="url(#{plot.ident}-clip{number})">{"".join(marks)}</g></g>')
    size = (plot.width, max(p.y.start for p in panels) + X_AXIS)
    return svg(plot.ident, size, plot.title, plot.text, parts)


def lay_out(plot: Plot) -> list[Panel]:
    """Return the panel of each area as it is shown at first."""
    full, margin = x_range(plot), LEFT if plot.columns == 1 else COLUMN_LEFT
    pitch = (plot.width - RIGHT) / plot.columns
    out, top = [], TOP
    for number, area in enumerate(plot.areas):
        column = number % plot.columns
        view = full if area.whole or plot.x_view is None else plot.x_view
        values = [*_values(area.marks, view), np.zeros(0)]
        fitted = around_zero(np.concatenate(values)) if area.around_zero else span_of(*values)
        box = (margin + column * pitch, top, pitch - margin, area.height)
        out.append(panel(view, fitted if area.y_range is None else area.y_range, box))
        if column + 1 == plot.columns:
            labels_below = plot.columns == 1 and has_x_axis(plot, number)  # in columns nothing is below them
            top += area.height + BETWEEN + (X_AXIS - 6.0 if labels_below else 0.0)
    return out


def has_x_axis(plot: Plot, number: int) -> bool:
    """Return whether an area has labels at its x axis: the last one of its column over the same range."""
    below = number + plot.columns
    return below >= len(plot.areas) or plot.areas[number].whole != plot.areas[below].whole


def find_name_x(plot: Plot, p: Panel) -> float:
    """Return where the name of an area begins [px]: at the figure's edge, or in columns over the area."""
    return 4.0 if plot.columns == 1 else p.x.start


def x_range(plot: Plot) -> tuple[float, float]:
    """Return the range of all x; padded if both axes are free."""
    every = [mark.x for area in plot.areas for mark in area.marks]
    if plot.free:
        return span_of(*every, np.zeros(0))
    values = np.concatenate([x[[0, -1]] for x in every if len(x)] or [np.array([0.0, 1.0])])
    return float(values.min()), float(values.max())


def draw_mark(p: Panel, mark: PlotMark) -> str:
    """Return a mark within the range of x of a panel."""
    if isinstance(mark, PlotDots):
        return dots(p, mark.x, mark.y, mark.css)
    if isinstance(mark, PlotShade):  # each of its parts is at least a pixel wide
        pixel = (p.x.high - p.x.low) / (p.x.stop - p.x.start)
        spans = np.clip(mark.spans(pixel), p.x.low, p.x.high)
        return "".join(p.rect(a, max(b, a + pixel), mark.css) for a, b in spans if b > a or p.x.low < a < p.x.high)
    some = slice(None)
    if len(mark.x) > 1 and not (np.diff(mark.x) < 0.0).any():
        some = slice(int(np.searchsorted(mark.x, p.x.low)), int(np.searchsorted(mark.x, p.x.high, "right")))
    if isinstance(mark, PlotLine):
        return line(p, mark.x[some], mark.y[some], mark.css, None if mark.breaks is None else mark.breaks[some])
    return between(p, mark.x[some], mark.low[some], mark.high[some], mark.css)


def _values(marks: Sequence[PlotMark], view: tuple[float, float]) -> Iterator[F]:
    """Yield the values of y that the range of the axis must show."""
    for mark in marks:
        if isinstance(mark, PlotLine | PlotDots):
            yield mark.y[(mark.x >= view[0]) & (mark.x <= view[1])]
