"""SVG drawing: scales, panels and axes. The page's style sheet sets colours and fonts.

Elements have class names only, never colours, so that one figure serves light, dark and print.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from ces_report.typesetting import minus

F = NDArray[np.float64]  # the types of arrays in signatures: floats, integers, truth values
I = NDArray[np.int64]  # noqa: E741
Mask = NDArray[np.bool_]

STEPS = (1.0, 2.0, 5.0, 10.0)
MIN_SPACING = 17.0  # [px] between the labels of ticks
SLOT = 122.0  # [px] for one entry of a legend
FAINTEST = 0.10  # opacity of a cell with a shade of 0
RAMP_CELLS = 24
RAMP_WIDTH = 300.0  # [px]


@dataclass(frozen=True)
class PlotAxis:
    """Values from `low` to `high` drawn from pixel `start` to pixel `stop`."""

    low: float
    high: float
    start: float
    stop: float

    def px(self, values: F | float) -> F:
        """Return the pixels of `values`."""
        share = (np.asarray(values, float) - self.low) / (self.high - self.low)
        return np.asarray(self.start + share * (self.stop - self.start))

    def ticks(self, max_count: int) -> list[tuple[float, str]]:
        """Return up to `max_count` round values inside the axis with their labels."""
        if max_count < 1:
            return []
        rough = (self.high - self.low) / max_count
        decade = 10.0 ** math.floor(math.log10(rough))
        step = next(s * decade for s in STEPS if s * decade >= rough * (1 - 1e-9))
        decimals = max(0, -math.floor(math.log10(step) + 1e-9))
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        return [(i * step, minus(f"{i * step:.{decimals}f}")) for i in range(first, last + 1)]

    def three_ticks(self) -> list[tuple[float, str]]:
        """Return ticks at 0 (with a label if it fits) and at the largest round value on both sides of it."""
        decade = 10.0 ** math.floor(math.log10(self.high))
        step = max(s * decade for s in STEPS if s * decade <= self.high)
        decimals = max(0, -math.floor(math.log10(step) + 1e-9))
        zero = "0" if abs(self.px(step) - self.px(0.0)) >= MIN_SPACING else ""
        return [(-step, minus(f"{-step:.{decimals}f}")), (0.0, zero), (step, f"{step:.{decimals}f}")]


@dataclass(frozen=True)
class Panel:
    """A plot area: `x` runs to the right, `y` upwards (so `y.start` is its lower edge)."""

    x: PlotAxis
    y: PlotAxis

    def rect(self, x0: float, x1: float, css: str, y0: float | None = None, y1: float | None = None) -> str:
        """Return a rectangle from `x0` to `x1`, over the whole height without `y0` and `y1`."""
        left, right = np.sort(self.x.px(np.array([x0, x1])))
        low, high = self.y.low if y0 is None else y0, self.y.high if y1 is None else y1
        top, bottom = np.sort(self.y.px(np.array([low, high])))
        size = f'width="{right - left:.1f}" height="{bottom - top:.1f}"'
        return f'<rect class="{css}" x="{left:.1f}" y="{top:.1f}" {size}/>'


def panel(x_range: tuple[float, float], y_range: tuple[float, float], box: tuple[float, float, float, float]) -> Panel:
    """Return a panel in `box` = (left, top, width, height) [px]; an empty range is widened."""
    left, top, width, height = box
    return Panel(PlotAxis(*_open(*x_range), left, left + width), PlotAxis(*_open(*y_range), top + height, top))


def svg(
    ident: str, size: tuple[float, float], title: str, description: str, parts: Sequence[str], values: bool = False
) -> Markup:
    """Return a figure of `size` (width, height) with an accessible name; `ident` must be unique in the page.

    With `values` the page's script (`values.js`) reads out the elements that `with_value` returned.
    """
    width, height = size
    kind = ' class="values"' if values else ""
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg"{kind} viewBox="0 0 {width:g} {height:g}" role="img" '
        f'aria-labelledby="{ident}-t {ident}-d"><title id="{ident}-t">{escape(title)}</title>'
        f'<desc id="{ident}-d">{escape(description)}</desc>'
    )
    return Markup(head + "\n".join(parts) + "</svg>")  # all texts in the parts are escaped


def axes(
    p: Panel, x_label: str, y_label: str, x_ticks: int = 7, y_ticks: int | None = 5, name_x: float | None = None
) -> str:
    """Return grid, tick labels and axis labels (x only with `x_label`); `y_ticks` None: y is an axis around zero.

    The label of the y axis begins at `name_x` [px], at the left edge of the figure without it.
    """
    left, right, bottom, top = p.x.start, p.x.stop, p.y.start, p.y.stop
    out = []
    for value, text in p.x.ticks(x_ticks):
        x = float(p.x.px(value))
        out.append(f'<path class="{_grid(value)}" d="M{x:.1f},{top:.1f}V{bottom:.1f}"/>')
        if x_label:
            out.append(label(x, bottom + 19, text, "tick mid"))
    for value, text in p.y.three_ticks() if y_ticks is None else p.y.ticks(y_ticks):
        y = float(p.y.px(value))
        out.append(f'<path class="{_grid(value)}" d="M{left:.1f},{y:.1f}H{right:.1f}"/>')
        out.append(label(left - 7, y + 4, text, "tick end"))
    out.append(label(4.0 if name_x is None else name_x, top - 11, y_label, "name"))
    if x_label:
        out.append(label(right, bottom + 36, x_label, "name end"))
    return "\n".join(out)


def with_value(drawn: str, text: str) -> str:
    """Return what was `drawn` as one value of a figure, which is read out as `text`."""
    return f'<g class="value">{drawn}<title>{escape(text)}</title></g>'


def note(p: Panel, text: str) -> str:
    """Return a text in the middle of the panel."""
    return label((p.x.start + p.x.stop) / 2, (p.y.start + p.y.stop) / 2 + 4, text, "tick mid")


def label(x: float, y: float, text: str, css: str) -> str:
    """Return a text at (x, y)."""
    return f'<text class="{css}" x="{x:.1f}" y="{y:.1f}">{escape(text)}</text>'


def legend(right: float, y: float, entries: Sequence[tuple[str, str]]) -> str:
    """Return a row of (class, text) that ends at `right`, each with a swatch."""
    out = []
    for i, (css, text) in enumerate(entries):
        x = right - SLOT * (len(entries) - i) + 6
        out.append(f'<path class="{css} swatch" d="M{x:.1f},{y - 4:.1f}h20"/>')
        out.append(label(x + 26, y, text, "name"))
    return "\n".join(out)


def span_of(*arrays: F) -> tuple[float, float]:
    """Return the padded range of all finite values."""
    values = np.concatenate(arrays)
    values = values[np.isfinite(values)]
    if not len(values):
        return -1.0, 1.0
    low, high = float(values.min()), float(values.max())
    return low - 0.05 * (high - low), high + 0.05 * (high - low)


def around_zero(error: F) -> tuple[float, float]:
    """Return a padded range around zero that holds all finite values."""
    worst = float(np.nanmax(np.abs(error), initial=0.0)) if np.isfinite(error).any() else 0.0
    return (-1.05 * worst, 1.05 * worst) if worst > 0.0 else (-1.0, 1.0)


def _grid(value: float) -> str:
    return "zero" if abs(value) < 1e-12 else "grid"


def _open(low: float, high: float) -> tuple[float, float]:
    least = max(1e-9, 1e-6 * max(abs(low), abs(high)))
    return (low, high) if high - low > least else (low - 0.5 * max(least, 1e-3), high + 0.5 * max(least, 1e-3))


def line(p: Panel, x: F, y: F, css: str, breaks: Mask | None = None) -> str:
    """Return the curve through the finite points (n,), interrupted before each tick where `breaks` is true."""
    if len(x) > 3 * abs(p.x.stop - p.x.start):
        return band(p, x, y, css)
    finite = np.isfinite(y)
    lift = ~np.concatenate([[False], finite[:-1]]) | (np.zeros(len(x), bool) if breaks is None else breaks)
    points = zip(np.where(lift, "M", "L")[finite], p.x.px(x)[finite], p.y.px(y)[finite], strict=True)
    return _path(css, "".join(f"{pen}{a:.1f},{b:.1f}" for pen, a, b in points))


def band(p: Panel, x: F, y: F, css: str) -> str:
    """Return the area between extremes of y (n,) in pixel columns, interrupted at empty ones; jumps are drawn."""
    finite, column, starts = _pixel_columns(p, x, y)
    if not len(starts):
        return ""
    pixels = p.y.px(y[finite])
    top, bottom = np.minimum.reduceat(pixels, starts), np.maximum.reduceat(pixels, starts)
    after = starts[1:]
    joined = (column[after] - column[after - 1] == 1) & (finite[after] - finite[after - 1] == 1)
    top[:-1] = np.where(joined, np.minimum(top[:-1], pixels[after]), top[:-1])
    bottom[:-1] = np.where(joined, np.maximum(bottom[:-1], pixels[after]), bottom[:-1])
    return _area(css, column[starts], top - 0.5, bottom + 0.5)


def between(p: Panel, x: F, low: F, high: F, css: str) -> str:
    """Return the area between two lines: by pixel columns if it has more points than these, else point by point."""
    if len(x) > p.x.stop - p.x.start:
        return _corridor(p, x, low, high, css)
    finite = np.isfinite(low + high)
    pieces = np.split(np.arange(len(x)), np.flatnonzero(np.diff(finite)) + 1)
    shown = [some for some in pieces if len(some) > 1 and finite[some[0]] and (high > low)[some].any()]
    return "".join(_ribbon(p, x[some], low[some], high[some], f"{css} area") for some in shown)


def _corridor(p: Panel, x: F, low: F, high: F, css: str) -> str:
    """Return the area between `low` and `high` (n,), interrupted at pixel columns without a finite point."""
    finite, column, starts = _pixel_columns(p, x, low + high)
    if not len(starts):
        return ""
    top = np.minimum.reduceat(p.y.px(np.minimum(high[finite], p.y.high)), starts)
    bottom = np.maximum.reduceat(p.y.px(np.maximum(low[finite], p.y.low)), starts)
    return _area(css, column[starts], top, bottom)


def _pixel_columns(p: Panel, x: F, y: F) -> tuple[I, I, I]:
    """Return the finite points, the pixel column of each, and the first point of each column among them."""
    finite = np.flatnonzero(np.isfinite(y))
    column = np.floor(p.x.px(x[finite])).astype(int)
    return finite, column, np.flatnonzero(np.diff(column, prepend=column[:1] - 1))


def _ribbon(p: Panel, x: F, low: F, high: F, css: str) -> str:
    there, back = zip(p.x.px(x), p.y.px(high), strict=True), zip(p.x.px(x)[::-1], p.y.px(low)[::-1], strict=True)
    return _path(css, "M" + "L".join(f"{a:.1f},{b:.1f}" for a, b in (*there, *back)) + "Z")


def dots(p: Panel, x: F, y: F, css: str) -> str:
    """Return a dot at each finite point (n,)."""
    finite = np.isfinite(y)
    points = zip(p.x.px(x[finite]), p.y.px(y[finite]), strict=True)
    return _path(css, "".join(f"M{a:.1f},{b:.1f}h0" for a, b in points))


def _area(css: str, column: I, top: F, bottom: F) -> str:
    """Return the area between two edges [px] over some pixel columns."""
    loops = []
    for c in np.split(np.arange(len(column)), np.flatnonzero(np.diff(column) > 1) + 1):
        x = np.concatenate([[column[c[0]]], column[c] + 0.5, [column[c[-1]] + 1]])
        there = zip(x, np.pad(top[c], 1, "edge"), strict=True)
        back = zip(x[::-1], np.pad(bottom[c], 1, "edge")[::-1], strict=True)
        loops.append("M" + "L".join(f"{a:.1f},{b:.1f}" for a, b in (*there, *back)) + "Z")
    return _path(css + " area", "".join(loops))


def _path(css: str, d: str) -> str:
    return f'<path class="{css}" d="{d}"/>' if d else ""


def cells(p: Panel, edges: tuple[F, F], values: F, shade: F, css: str, describe: Callable[[int, int], str]) -> str:
    """Return a rectangle for each cell (x, y) with `values` above 0, darker with `shade` (0 to 1).

    `edges` (x + 1,), (y + 1,) are on the panel's axes; `describe` returns the text of a cell.
    """
    out = []
    for a, b in zip(*np.nonzero(np.nan_to_num(values) > 0.0), strict=True):
        x, y = edges[0][a : a + 2], edges[1][b : b + 2]
        box = p.rect(x[0], x[1], f"{css} value", y[0], y[1]).removesuffix("/>")
        out.append(f'{box} fill-opacity="{_opacity(shade[a, b]):.2f}"><title>{escape(describe(a, b))}</title></rect>')
    return "\n".join(out)


def ramp(left: float, top: float, values: Sequence[float], css: str, unit: str, width: float = RAMP_WIDTH) -> str:
    """Return the scale from the faintest to the darkest cell with evenly spaced `values`."""
    step = width / RAMP_CELLS
    out = []
    for i in range(RAMP_CELLS):
        box = f'x="{left + i * step:.1f}" y="{top:.1f}" width="{step:.1f}" height="11"'
        out.append(f'<rect class="{css}" {box} fill-opacity="{_opacity(i / (RAMP_CELLS - 1)):.2f}"/>')
    for i, value in enumerate(values):
        text = f"{value:.0f}" if value >= 99.5 else f"{value:.2g}"
        out.append(label(left + width * i / (len(values) - 1), top + 27, text, "tick mid"))
    return "\n".join([*out, label(left + width + 20, top + 10, unit, "name")])


def _opacity(shade: float) -> float:
    return FAINTEST + (1.0 - FAINTEST) * shade
