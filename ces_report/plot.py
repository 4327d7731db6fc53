"""Charts as HTML: legend, figure, table of values, and their data as compact JSON; curves, or intervals in rows.

The data are 16-bit steps in base64; long lines keep the extremes of groups of samples.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from ces_report.drawing import F, I, Mask, Panel, axes, label, panel, span_of, svg, with_value
from ces_report.figure import (
    MAX_ENTRIES,
    Plot,
    PlotArea,
    PlotBand,
    PlotDots,
    PlotLine,
    PlotMark,
    PlotScale,
    PlotShade,
    curve_css,
    draw_svg,
    find_name_x,
    has_x_axis,
    lay_out,
    series_css,
    x_range,
)
from ces_report.table import Section, text_table
from ces_report.typesetting import Chart, ChartCurve, minus

__all__ = [
    "Plot", "PlotArea", "PlotBand", "PlotDots", "PlotLine", "PlotMark", "PlotScale", "PlotShade", "curve_css",
    "draw_plot", "series_css", "share_points",
]  # fmt: skip

MAX_POINTS = 60_000  # of a line
PAGE_BYTES = 2_700_000  # of a page with the data of all its charts
FIGURE_BYTES = 200_000  # of the figures of a recording, without data
MIN_BYTES = 300_000  # of the data of all charts of a page
POINT_BYTES = 2 / 3 * 4  # of one value of a line in base64
MISSING = 65535  # stands for a value that is not finite
STEPS = MISSING - 1
GAP = 3.0  # of the usual step of x: a longer one interrupts the extremes
HEADS = ("Shown", "Points", "Lowest", "at", "Highest", "at", "Mean")
SWATCHES = {"line": "M1,5h20", "dots": "M5,5h0M11,5h0M17,5h0"}


def share_points(lines: int, recordings: int = 4) -> int:
    """Return the points of each of `lines` lines (a band is two) on a page below 3 MB with figures of `recordings`."""
    data = max(PAGE_BYTES - FIGURE_BYTES * recordings, MIN_BYTES)
    return int(min(MAX_POINTS, data / (POINT_BYTES * max(lines, 1))))


def draw_plot(plot: Plot, max_points: int = MAX_POINTS, table: Markup | None = None) -> Markup:
    """Return a plot as HTML: legend, figure, data and a table of the values that it shows, or the given `table`.

    Lines with more than `max_points` points keep the lowest and the highest value of groups of samples in the data,
    and the plot says so; see `share_points` for pages with many lines.
    """
    panels = lay_out(plot)
    data, samples = _pack(plot, panels, max_points)
    kept = "" if samples == 1 else f"Data of this chart: lowest and highest of every {samples} samples."
    group = Markup(' data-group="{}"').format(plot.group) if plot.group else Markup("")
    return Markup('<div class="plot" id="{}-plot"{}>{}{}{}{}<script type="application/json">{}</script></div>').format(
        plot.ident,
        group,
        _legend(plot) if plot.legend else "",
        draw_svg(plot, panels),
        Markup('<p class="plot-resolution">{}</p>').format(kept) if kept else "",
        value_table(f"{plot.text} \u201cAt\u201d is {plot.x_label}.", HEADS, list(_rows(plot)))
        if table is None
        else table,
        data,
    )


def _legend(plot: Plot) -> Markup:
    """Return a list of the names of all marks, or of their groups, each with the swatch of the first such mark."""
    first: dict[str, PlotMark] = {}
    groups: dict[str, PlotMark] = {}
    for mark in (mark for area in plot.areas for mark in area.marks if mark.name):
        first.setdefault(mark.name, mark)
        groups.setdefault(getattr(mark, "group", "") or mark.name, mark)
    more, shown = Markup(""), first
    if len(first) > MAX_ENTRIES:
        shown = groups if plot.scale is not None else dict(list(first.items())[: MAX_ENTRIES - 1])
        more = (
            Markup("<li>and {} more</li>").format(len(first) - len(shown)) if plot.scale is None else _ramp(plot.scale)
        )
    entries = more + Markup("").join(
        Markup('<li data-name="{}">{}{}</li>').format(name, _swatch(mark), name) for name, mark in shown.items()
    )
    return Markup('<ul class="plot-legend">{}</ul>').format(entries) if entries else Markup("")


def _ramp(scale: PlotScale) -> Markup:
    """Return the entry of a legend that shows the colours of a scale."""
    parts = [Markup('<path class="{}" d="M{},5h14"/>').format(css, 14 * n) for n, css in enumerate(scale.styles)]
    width = 14 * len(parts)
    ramp = Markup('<svg class="plot-scale" style="width:{0}px" viewBox="0 0 {0} 10" aria-hidden="true">{1}</svg>')
    return Markup("<li>{}{}{}</li>").format(scale.low, ramp.format(width, Markup("").join(parts)), scale.high)


def _swatch(mark: PlotMark) -> Markup:
    """Return a small picture of how a mark is drawn."""
    if isinstance(mark, PlotShade):
        inner = Markup('<rect class="{}" x="1" y="0" width="20" height="10"/>').format(mark.css)
    elif isinstance(mark, PlotBand):
        inner = Markup('<path class="{} area" d="M1,0h20v10h-20Z"/>').format(mark.css)
    else:
        kind = "dots" if {"dots", "spot"} & set(mark.css.split()) else "line"
        inner = Markup('<path class="{}" d="{}"/>').format(mark.css, SWATCHES[kind])
    return Markup('<svg class="plot-swatch" viewBox="0 0 22 10" aria-hidden="true">{}</svg>').format(inner)


def _pack(plot: Plot, panels: Sequence[Panel], max_points: int) -> tuple[Markup, int]:
    """Return a plot's JSON, the same text in HTML and XML, and how many samples two points of a long line stand for."""
    packer = _Packer(max_points)
    areas = []
    for number, (area, p) in enumerate(zip(plot.areas, panels, strict=True)):
        box = [p.x.start, p.y.stop, p.x.stop - p.x.start, p.y.start - p.y.stop]
        areas.append(
            {
                "box": [round(v, 1) for v in box],
                "label": area.y_label,
                "y": [p.y.low, p.y.high],
                "fixed": area.y_range is not None,
                "zero": area.around_zero,
                "whole": area.whole,
                "yTicks": area.y_ticks,
                "nameX": find_name_x(plot, p),
                "xLabel": plot.x_label if has_x_axis(plot, number) else "",
                "marks": [packer.mark(mark) for mark in area.marks],
            }
        )
    first = next((p for a, p in zip(plot.areas, panels, strict=True) if not a.whole), panels[0])
    full = panels[0].x if plot.free else None
    content = {
        "x": plot.x_label,
        "xTicks": plot.x_ticks,
        "free": plot.free,
        "view": [first.x.low, first.x.high],
        "full": [full.low, full.high] if full else list(x_range(plot)),
        "areas": areas,
        "arrays": packer.arrays,
    }
    text = json.dumps(content, separators=(",", ":"), allow_nan=False, ensure_ascii=True)
    safe = text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
    return Markup(safe), packer.samples


class _Packer:
    """The arrays of a plot's marks; an array that several marks share is packed once."""

    def __init__(self, max_points: int) -> None:
        self.arrays: list[dict[str, Any]] = []
        self.samples = 1
        self._max_points = max_points
        self._known: dict[tuple[bool, bytes], int] = {}

    def mark(self, mark: PlotMark) -> dict[str, Any]:
        """Return a mark with the numbers of its arrays."""
        head = {"name": mark.name, "group": getattr(mark, "group", ""), "css": mark.css}
        if isinstance(mark, PlotDots):
            return {**head, "kind": "dots", "x": self._add(mark.x, wide=True), "y": self._add(mark.y)}
        if isinstance(mark, PlotShade):  # what is closer than the finest pixel is one
            room = float(np.ptp(mark.x)) / MAX_POINTS if len(mark.x) else 0.0
            return {**head, "kind": "shade", "spans": [[float(a), float(b)] for a, b in mark.spans(room)]}
        breaks = mark.breaks if isinstance(mark, PlotLine) else None
        size = 1 if len(mark.x) <= self._max_points else -(-2 * len(mark.x) // self._max_points)
        starts, self.samples = _group_starts(mark.x, breaks, size), max(self.samples, size)
        x = self._add(mark.x if size == 1 else _centres(mark.x, starts), wide=True)
        if isinstance(mark, PlotBand):
            low, high = mark.low, mark.high
            if size > 1:
                low, high = np.repeat(np.fmin.reduceat(low, starts), 2), np.repeat(np.fmax.reduceat(high, starts), 2)
            return {**head, "kind": "band", "x": x, "low": self._add(low), "high": self._add(high)}
        y = self._add(mark.y if size == 1 else _extremes(mark.y, starts))
        at = np.zeros(0) if breaks is None else np.flatnonzero(breaks)
        at = at if size == 1 else 2 * np.searchsorted(starts, at)
        return {**head, "kind": "line", "x": x, "y": y, "breaks": [int(b) for b in at if b]}

    def _add(self, values: F, wide: bool = False) -> int:
        key = wide, values.tobytes()
        if key not in self._known:
            self._known[key] = len(self.arrays)
            self.arrays.append(_encode(np.asarray(values, np.float64), wide))
        return self._known[key]


def _group_starts(x: F, breaks: Mask | None, size: int) -> I:
    """Return the first sample of each group that becomes two points; none spans a gap of x or a break."""
    step = np.diff(x)
    usual = float(np.median(np.abs(step))) if len(step) else 0.0
    apart = np.concatenate([[True], np.abs(step) > GAP * usual])[: len(x)]
    if breaks is not None:
        apart = apart | breaks
    first = np.flatnonzero(apart)
    since = np.arange(len(x)) - np.repeat(first, np.diff(np.append(first, len(x))))
    return np.flatnonzero(since % size == 0)


def _centres(x: F, starts: I) -> F:
    """Return the two values of x of each group: at its first and at its middle sample."""
    middle = (starts + np.append(starts[1:], len(x))) // 2
    return np.stack([x[starts], x[middle]], axis=1).ravel()


def _extremes(y: F, starts: I) -> F:
    """Return the lowest and the highest value of each group, in the order in which the line rises or falls."""
    low, high = np.fmin.reduceat(y, starts), np.fmax.reduceat(y, starts)
    falls = y[np.append(starts[1:], len(y)) - 1] < y[starts]
    return np.where(falls[:, None], np.stack([high, low], 1), np.stack([low, high], 1)).ravel()


def _encode(values: F, wide: bool) -> dict[str, Any]:
    """Return an array as a start and a step if it is even, else as 16-bit (`wide`: 32-bit) steps of its range."""
    n = len(values)
    finite = np.isfinite(values)
    if not finite.any():
        return {"n": n, "even": [None, 0.0]}
    if finite.all():
        step = float(values[-1] - values[0]) / max(n - 1, 1)
        if np.abs(values - values[0] - step * np.arange(n)).max() <= 1e-6 * abs(step):
            return {"n": n, "even": [float(values[0]), step]}
    steps, kind = (2**32 - 2, "<u4") if wide else (STEPS, "<u2")
    low, high = float(values[finite].min()), float(values[finite].max())
    unit = (high - low) / steps or 1.0
    whole = np.where(finite, np.rint((np.where(finite, values, low) - low) / unit), steps + 1).astype(kind)
    data = base64.b64encode(whole.tobytes()).decode()
    return {"n": n, "low": low, "unit": unit, "bits": 32 if wide else 16, "data": data}


def value_table(caption: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> Markup:
    """Return the values of a figure as a table that the reader can open; each row begins with its name."""
    table = text_table(heads, rows).to_html(repeat_heads=False)
    return Markup(
        '<details class="plot-table"><summary>Values of this chart</summary><p>{}</p>'
        '<div class="wide">{}</div></details>'
    ).format(caption, table)


def _rows(plot: Plot) -> Iterator[tuple[str, ...]]:
    """Yield the number of points, the extremes and the mean of each mark; an area that repeats another one has none."""
    for area, mark in ((one, mark) for one in plot.areas if not one.whole for mark in one.marks):
        if isinstance(mark, PlotShade):
            continue
        if isinstance(mark, PlotBand):
            x, values = mark.x, {", lower end": mark.low, ", upper end": mark.high}
        else:
            x, values = mark.x, {"": mark.y}
        same = area.y_label.lower().startswith(mark.name.lower())
        for suffix, y in values.items():
            name = area.y_label if same else f"{mark.name}{suffix}: {area.y_label}"
            some, at = y[np.isfinite(y)], x[np.isfinite(y)]
            if not len(some):
                yield name, "0", *["–"] * 5
                continue
            low, high = int(some.argmin()), int(some.argmax())
            numbers = (some[low], at[low], some[high], at[high], some.mean())
            yield name, str(len(some)), *(minus(f"{float(v):.4g}") for v in numbers)


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


def draw_section(section: Section) -> list[tuple[Markup, str]]:
    """Return the charts of a section, each with its caption."""
    sized = zip(section.charts, SIZES, strict=False)
    return [(draw_chart(f"{section.ident}{n}", chart, size), chart.caption) for n, (chart, size) in enumerate(sized)]


def draw_chart(ident: str, chart: Chart, size: tuple[float, float]) -> Markup:
    """Return a chart of about `size` (width, height) [px]."""
    width, height = size
    curves = chart.curves
    marks = [mark for n, curve in enumerate(curves) for mark in _marks(curve, curve_css(n, len(curves)))]
    drawn = [np.concatenate([c.y - c.half, c.y + c.half, *([] if c.points is None else [c.points[1]])]) for c in curves]
    low, high = min(float(y.min()) for y in drawn), max(float(y.max()) for y in drawn)
    room = 0.05 * (high - low)
    area = PlotArea(chart.y_label, marks, height=height - 84.0, y_range=(low - room, high + room), y_ticks=7)
    return draw_plot(Plot(ident, chart.title, chart.caption, chart.x_label, [area], width, x_ticks=7))


def _marks(curve: ChartCurve, css: str) -> Iterator[PlotMark]:
    """Yield the interval of a curve, the part that was recorded, and the parts below and above it."""
    low, high = curve.recorded
    if curve.points is not None:
        yield PlotDots(curve.dots, *curve.points, css=f"{css} spot")
    if curve.half.any():
        yield PlotBand(curve.name, curve.x, curve.y - curve.half, curve.y + curve.half, f"interval {css.split()[1]}")
    for first, last, kind in ((low, high, css), (-np.inf, low, f"{css} beyond"), (high, np.inf, f"{css} beyond")):
        start, stop = np.clip([first, last], curve.x[0], curve.x[-1])
        if start < stop:
            x = np.concatenate([[start], curve.x[(curve.x > start) & (curve.x < stop)], [stop]])
            yield PlotLine(curve.name, x, np.interp(x, curve.x, curve.y), kind)
