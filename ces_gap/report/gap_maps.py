"""Figures of the gap over two axes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from ces_gap.diagnosis import GapMap
from ces_gap.report.formatting import AXES, axis_figure, axis_title
from ces_identify.report.drawing import F, Panel, axes, label, note, panel, svg
from ces_identify.report.heat_map import cells, ramp
from ces_identify.report.plot_table import value_table
from ces_identify.typesetting import minus

SIZE = (360.0, 326.0)
BOX = (48.0, 30.0, 304.0, 206.0)  # left, top, width, height [px]
RAMP = (48.0, 290.0, 200.0)  # left, top, width [px]
TABLE_CELLS = 12
SCALE = (0.0, 0.5, 1.0)
EQUAL_WIDTH = "since_reversal_s"  # an axis whose regions are drawn with equal width
ROOM = 34.0  # [px] for the label of an edge of it


def draw_gap_maps(ident: str, maps: Sequence[GapMap]) -> list[Markup]:
    """Return a figure for each map that has more than one row or column; all share one scale of force."""
    shown = [m for m in maps if min(m.rms_N.shape) > 1]
    worst = max([float(np.nanmax(m.rms_N, initial=0.0)) for m in shown if np.isfinite(m.rms_N).any()] + [1e-9])
    return [_figure(f"{ident}-{i}", m, worst) for i, m in enumerate(shown)]


def _figure(ident: str, m: GapMap, worst: float) -> Markup:
    edges = _displayed_edges(m, 0), _displayed_edges(m, 1)
    p = panel((edges[0][0], edges[0][-1]), (edges[1][0], edges[1][-1]), BOX)
    rms = m.rms_N.T

    def describe(a: int, b: int) -> str:
        return f"{_span(m, 0, a)}, {_span(m, 1, b)}: {rms[a, b]:.3g} N"

    parts = [_axes(p, m), cells(p, edges, rms, rms / worst, "wrong", describe)]
    parts.append(ramp(*RAMP[:2], [f * worst for f in SCALE], "wrong", "N, RMS gap", RAMP[2]))
    if not np.isfinite(rms).any():
        parts.append(note(p, "too few samples"))
    title = f"RMS gap over {AXES[m.axes[0]][0]} and {AXES[m.axes[1]][0]}"
    text = f"The scale ends at {worst:.3g} N."
    return svg(ident, SIZE, title, text, parts, values=True) + value_table(text, ("Cell", "RMS gap [N]"), _highest(m))


def _highest(m: GapMap) -> list[tuple[str, str]]:
    """Return the cells with the largest gap, with their values."""
    rms = m.rms_N.T
    order = np.argsort(-np.nan_to_num(rms), axis=None)[:TABLE_CELLS]
    cells_of = [(a, b) for a, b in zip(*np.unravel_index(order, rms.shape), strict=True) if rms[a, b] > 0.0]
    return [(f"{_span(m, 0, a)}, {_span(m, 1, b)}", f"{rms[a, b]:.3g}") for a, b in cells_of]


def _displayed_edges(m: GapMap, k: int) -> F:
    """Return the edges as drawn: in the displayed unit, or as numbers 0, 1, 2 and so on."""
    if m.axes[k] == EQUAL_WIDTH:
        return np.arange(len(m.edges[k]), dtype=np.float64)
    return np.asarray(AXES[m.axes[k]][2] * m.edges[k])


def _axes(p: Panel, m: GapMap) -> str:
    """Return grid and labels; an axis with equal widths, always the vertical one, is labelled at its edges."""
    if m.axes[1] != EQUAL_WIDTH:
        return axes(p, axis_title(m.axes[0]), axis_title(m.axes[1]), 6, 5)
    out = [axes(p, axis_title(m.axes[0]), axis_title(m.axes[1]), 6, 0)]
    stride = max(1, round(ROOM / 2 / float(p.y.px(0.0) - p.y.px(1.0))))
    texts = [axis_figure(EQUAL_WIDTH, e) for e in m.edges[1]]
    shown = range(0, len(texts), stride)
    out += [label(p.x.start - 7, float(p.y.px(float(k))) + 4, texts[k], "tick end") for k in shown]
    return "\n".join(out)


def _span(m: GapMap, k: int, cell: int) -> str:
    name, unit, _ = AXES[m.axes[k]]
    low, high = (axis_figure(m.axes[k], e) for e in m.edges[k][cell : cell + 2])
    return minus(f"{name} {low} to {high} {unit}")
