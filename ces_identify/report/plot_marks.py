"""What a chart shows: lines, dots, bands, bars and shades in areas over one x axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ces_identify.numerics.arrays import F, Mask

SERIES = 8  # classes s0 to s7: colours of things that have no order
CURVES = 4  # classes c0 to c3: colours that rise with their order, such as currents


@dataclass(frozen=True)
class PlotLine:
    """A line through the finite points of y (n,) over x (n,), interrupted before each point where `breaks` is true.

    `name` is the entry in the legend (none if empty); marks of the same name are shown and hidden together. `css` are
    classes of the style sheet, never colours. A line through points that are not in the order of x needs a plot with
    `free` axes.
    """

    name: str
    x: F
    y: F
    css: str = "measured"
    breaks: Mask | None = None


@dataclass(frozen=True)
class PlotDots:
    """A dot at each finite point of y (n,) over x (n,); `css` ends with `dots`, or with `spot` for larger ones."""

    name: str
    x: F
    y: F
    css: str = "measured dots"


@dataclass(frozen=True)
class PlotBand:
    """The area between `low` and `high` (n,) over x (n,) in its order; without a name its values are not read out."""

    name: str
    x: F
    low: F
    high: F
    css: str = "bounds"


@dataclass(frozen=True)
class PlotBars:
    """Bars from zero to `values` (n,) between `edges` (n + 1,) of x."""

    name: str
    edges: F
    values: F
    css: str = "cover"


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


PlotMark = PlotLine | PlotDots | PlotBand | PlotBars | PlotShade


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
class Plot:
    """A chart: areas below each other; `title` and `text` are its accessible name and its description in a sentence.

    `ident` must be unique in the page. `x_view` is the range of x that is shown at first and in print, None for all.
    Charts of one `group` zoom, move and read values together. `free`: zoom works on both axes, and values are read at
    the nearest point (speed-force clouds, loops); otherwise zoom works on x, and y follows what is visible.
    Areas fill `columns` row by row.
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


def series_css(number: int) -> str:
    """Return the classes of the line `number` (from 0) among things without an order; they repeat after SERIES."""
    return f"series s{number % SERIES}"


def curve_css(number: int, count: int) -> str:
    """Return the classes of the curve `number` of `count` that rise in their order, such as currents."""
    return f"curve c{round(number * (CURVES - 1) / (count - 1)) if count > 1 else CURVES - 3}"
