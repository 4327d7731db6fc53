"""A chart of intervals, one row each, over a common axis; every row has its values as text."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from ces_report.drawing import Panel, axes, label, panel, span_of, svg, with_value
from ces_report.plot import Plot, PlotArea, PlotBand, PlotLine, PlotMark, curve_css, draw_plot
from ces_report.typesetting import Chart, ChartCurve

WIDTH, LEFT, RIGHT, TOP, ROW, AXIS = 830.0, 270.0, 220.0, 12.0, 24.0, 46.0
INDENT = 18.0
MAX_NAME = 28  # letters of a row's name; more would reach the axis, in print at the latest
MINUS = " − "  # between the names of a difference
SIZES = ((620.0, 446.0), (440.0, 446.0), (620.0, 446.0))  # of the charts of a section


@dataclass(frozen=True)
class IntervalRow:
    """A row: its name, the interval (NaN: none), the value inside it (NaN: none), its text, and style-sheet classes.

    A row that `starts` a group has a rule above it; one that does not is `indent`ed if it belongs to the one above.
    """

    name: str
    low: float
    high: float
    value: float
    text: str
    css: str = "outline"
    starts: bool = False
    indent: bool = False


def draw_intervals(ident: str, title: str, x_label: str, rows: Sequence[IntervalRow], zero: bool = False) -> Markup:
    """Return the chart; with `zero` the axis includes zero."""
    values = np.array([v for row in rows for v in (row.low, row.high, row.value)] + ([0.0] if zero else []))
    height = ROW * len(rows)
    p = panel(span_of(values), (float(len(rows)), 0.0), (LEFT, TOP, WIDTH - LEFT - RIGHT, height))
    parts = [axes(p, x_label, "", 6, 0), *(_row(p, i, row) for i, row in enumerate(rows))]
    text = "; ".join(f"{row.name}: {row.text}" for row in rows)
    return svg(ident, (WIDTH, TOP + height + AXIS), title, text, parts, values=True)


def _row(p: Panel, i: int, row: IntervalRow) -> str:
    y = TOP + ROW * (i + 0.5)
    out = [
        f'<rect class="hit" x="0" y="{y - ROW / 2:.1f}" width="{WIDTH:.1f}" height="{ROW:.1f}"/>',
        label(INDENT if row.indent else 0.0, y + 4, _shorten(row.name), "name"),
        label(WIDTH, y + 4, row.text, "tick end"),
    ]
    if row.starts and i:
        out.append(f'<path class="grid" d="M0,{y - ROW / 2:.1f}H{WIDTH:.1f}"/>')
    if math.isfinite(row.low) and math.isfinite(row.high) and row.low < row.high:
        low, high = (float(p.x.px(v)) for v in (row.low, row.high))
        ends = f"M{low:.1f},{y - 4:.1f}v8M{high:.1f},{y - 4:.1f}v8"
        out.append(f'<path class="{row.css}" d="M{low:.1f},{y:.1f}H{high:.1f}{ends}"/>')
    if math.isfinite(row.value):
        out.append(f'<path class="{row.css} spot" d="M{float(p.x.px(row.value)):.1f},{y:.1f}h0"/>')
    return with_value("".join(out), f"{row.name}: {row.text}")


def _shorten(name: str) -> str:
    """Return a name without its middle if it is too long; of a difference, each of the two names."""
    first, minus, second = name.partition(MINUS)
    if len(name) <= MAX_NAME or not minus:
        return _leave_out(name, MAX_NAME)
    half = (MAX_NAME - len(MINUS)) // 2
    return f"{_leave_out(first, half)}{MINUS}{_leave_out(second, half)}"


def _leave_out(name: str, most: int) -> str:
    return name if len(name) <= most else f"{name[: most // 3]}…{name[most // 3 + 1 - most :]}"


def draw_chart(ident: str, chart: Chart, size: tuple[float, float]) -> Markup:
    """Return a chart of about `size` (width, height) [px]."""
    width, height = size
    curves = chart.curves
    marks = [mark for n, one in enumerate(curves) for mark in _marks(one, curve_css(n, len(curves)))]
    low, high = min(float((c.y - c.half).min()) for c in curves), max(float((c.y + c.half).max()) for c in curves)
    room = 0.05 * (high - low)
    area = PlotArea(chart.y_label, marks, height=height - 84.0, y_range=(low - room, high + room), y_ticks=7)
    return draw_plot(Plot(ident, chart.title, chart.caption, chart.x_label, [area], width, x_ticks=7))


def _marks(curve: ChartCurve, css: str) -> Iterator[PlotMark]:
    """Yield the interval of a curve, the part that was recorded, and the parts below and above it."""
    low, high = curve.recorded
    if curve.half.any():
        yield PlotBand(curve.name, curve.x, curve.y - curve.half, curve.y + curve.half, f"interval {css.split()[1]}")
    for first, last, kind in ((low, high, css), (-np.inf, low, f"{css} beyond"), (high, np.inf, f"{css} beyond")):
        start, stop = np.clip([first, last], curve.x[0], curve.x[-1])
        if start < stop:
            x = np.concatenate([[start], curve.x[(curve.x > start) & (curve.x < stop)], [stop]])
            yield PlotLine(curve.name, x, np.interp(x, curve.x, curve.y), kind)
