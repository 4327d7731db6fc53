"""Charts of a model's curves with their 95 % intervals; dashed where nothing was recorded."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from markupsafe import Markup

from ces_identify.report.plot import Plot, PlotArea, PlotBand, PlotLine, PlotMark, curve_css, draw_plot
from ces_identify.typesetting import Chart, ChartCurve

SIZES = ((620.0, 446.0), (440.0, 446.0))  # of the first and the second chart of a section


def draw_chart(ident: str, chart: Chart, size: tuple[float, float]) -> Markup:
    """Return a chart of about `size` (width, height) [px]."""
    width, height = size
    curves = chart.curves
    marks = [mark for n, one in enumerate(curves) for mark in _marks(one, curve_css(n, len(curves)))]
    area = PlotArea(chart.y_label, marks, height=height - 84.0, y_range=_range(curves), y_ticks=7)
    return draw_plot(Plot(ident, chart.title, chart.caption, chart.x_label, [area], width, x_ticks=7))


def _range(curves: tuple[ChartCurve, ...]) -> tuple[float, float]:
    low, high = min(float((c.y - c.half).min()) for c in curves), max(float((c.y + c.half).max()) for c in curves)
    room = 0.05 * (high - low)
    return low - room, high + room


def _marks(curve: ChartCurve, css: str) -> Iterator[PlotMark]:
    low, high = curve.recorded
    if curve.half.any():
        yield PlotBand(curve.name, curve.x, curve.y - curve.half, curve.y + curve.half, f"interval {css.split()[1]}")
    yield from _piece(curve, low, high, css)
    yield from _piece(curve, -np.inf, low, f"{css} beyond")
    yield from _piece(curve, high, np.inf, f"{css} beyond")


def _piece(curve: ChartCurve, first: float, last: float, css: str) -> Iterator[PlotLine]:
    """Yield the part of a curve from `first` to `last`, if there is one."""
    low, high = np.clip([first, last], curve.x[0], curve.x[-1])
    if low < high:
        x = np.concatenate([[low], curve.x[(curve.x > low) & (curve.x < high)], [high]])
        yield PlotLine(curve.name, x, np.interp(x, curve.x, curve.y), css)
