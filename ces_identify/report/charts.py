"""Charts of a model's curves with their 95 % intervals; dashed where nothing was recorded."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from ces_identify.report.drawing import Panel, axes, label, panel, span_of, svg
from ces_identify.report.marks import line, ribbon
from ces_identify.typesetting import Chart, ChartCurve

SIZES = ((620, 446), (440, 446))  # of the first and the second chart of a section
COLOURS = 4
SPACING = 16.0  # [px] between the curves' names


def draw_chart(ident: str, chart: Chart, size: tuple[float, float]) -> Markup:
    """Return a chart of `size` (width, height) [px], with each curve's name at its end."""
    width, height = size
    curves = chart.curves
    named = 58.0 if any(curve.name for curve in curves) else 12.0
    box = (58.0, 34.0, width - 58.0 - named, height - 84.0)
    spans = [edge for one in curves for edge in (one.y - one.half, one.y + one.half)]
    p = panel(span_of(*(one.x for one in curves)), span_of(*spans), box)
    parts = [axes(p, chart.x_label, chart.y_label, 7, 7)]
    for n, curve in enumerate(curves):
        parts += _draw_curve(p, curve, f"c{_colour(n, len(curves))}")
    parts += _names(p, curves)
    return svg(ident, size, chart.title, chart.caption, parts)


def _colour(n: int, count: int) -> int:
    return round(n * (COLOURS - 1) / (count - 1)) if count > 1 else COLOURS - 3


def _draw_curve(p: Panel, curve: ChartCurve, css: str) -> list[str]:
    low, high = curve.recorded
    return [
        ribbon(p, curve.x, curve.y - curve.half, curve.y + curve.half, f"interval {css}"),
        _draw_piece(p, curve, -np.inf, low, f"curve beyond {css}"),
        _draw_piece(p, curve, high, np.inf, f"curve beyond {css}"),
        _draw_piece(p, curve, low, high, f"curve {css}"),
    ]


def _draw_piece(p: Panel, curve: ChartCurve, first: float, last: float, css: str) -> str:
    """Return the part of a curve from `first` to `last`; nothing if there is none."""
    low, high = np.clip([first, last], curve.x[0], curve.x[-1])
    if not low < high:
        return ""
    x = np.concatenate([[low], curve.x[(curve.x > low) & (curve.x < high)], [high]])
    return line(p, x, np.interp(x, curve.x, curve.y), css)


def _names(p: Panel, curves: tuple[ChartCurve, ...]) -> list[str]:
    """Return the curves' names at their right ends, from the lowest up, moved apart where they would overlap."""
    ends = sorted((float(p.y.px(curve.y[-1])), curve.name) for curve in curves if curve.name)[::-1]
    out, below = [], np.inf
    for y, name in ends:
        below = min(y, below - SPACING)
        out.append(label(p.x.stop + 8, below + 4, name, "tick"))
    return out
