"""The values of figures as tables: the text alternative of a chart, which opens below it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from markupsafe import Markup

from ces_identify.numerics.arrays import F
from ces_identify.report.plot_marks import Plot, PlotBand, PlotBars, PlotMark, PlotShade
from ces_identify.typesetting import minus

HEADS = ("Shown", "Points", "Lowest", "at", "Highest", "at", "Mean")


def plot_table(plot: Plot) -> Markup:
    """Return the table of a plot: of each mark the number of its points, its extremes and its mean."""
    return value_table(f"{plot.text} \u201cAt\u201d is {plot.x_label}.", HEADS, list(_rows(plot)))


def value_table(caption: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> Markup:
    """Return the values of a figure as a table that the reader can open; each row begins with its name."""
    head = _join('<th scope="col">{}</th>', heads)
    body = Markup("").join(
        Markup('<tr><th scope="row">{}</th>{}</tr>').format(name, _join('<td class="n">{}</td>', cells))
        for name, *cells in rows
    )
    return Markup(
        '<details class="plot-table"><summary>Values of this chart</summary><div class="wide"><table class="plain">'
        "<caption>{}</caption><thead><tr>{}</tr></thead><tbody>{}</tbody></table></div></details>"
    ).format(caption, head, body)


def _join(element: str, texts: Sequence[str]) -> Markup:
    return Markup("").join(Markup(element).format(text) for text in texts)


def _rows(plot: Plot) -> Iterator[tuple[str, ...]]:
    """Yield a row for each mark; an area that repeats what another one shows has none."""
    for area in (area for area in plot.areas if not area.whole):
        for mark in area.marks:
            same = area.y_label.lower().startswith(mark.name.lower())
            for suffix, x, y in _values(mark):
                name = area.y_label if same else f"{mark.name}{suffix}: {area.y_label}"
                yield name, *_statistics(x, y)


def _values(mark: PlotMark) -> Iterator[tuple[str, F, F]]:
    if isinstance(mark, PlotBand):
        yield from ((", lower end", mark.x, mark.low), (", upper end", mark.x, mark.high))
    elif isinstance(mark, PlotBars):
        yield "", 0.5 * (mark.edges[:-1] + mark.edges[1:]), mark.values
    elif not isinstance(mark, PlotShade):
        yield "", mark.x, mark.y


def _statistics(x: F, y: F) -> tuple[str, ...]:
    finite = np.isfinite(y)
    if not finite.any():
        return ("0", *["–"] * 5)
    x, y = x[finite], y[finite]
    low, high = int(y.argmin()), int(y.argmax())
    numbers = (y[low], x[low], y[high], x[high], y.mean())
    return (str(len(y)), *(minus(f"{float(v):.4g}") for v in numbers))
