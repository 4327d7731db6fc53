"""Maps of coverage and error over speed and current, or over speed only if the current is constant."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from ces_identify.numerics.arrays import F, Mask
from ces_identify.report.drawing import Panel, axes, legend, note, panel, svg
from ces_identify.report.grid import SpeedCurrentGrid
from ces_identify.report.heat_map import cells, ramp
from ces_identify.report.plot import Plot, PlotArea, PlotBars, draw_plot
from ces_identify.report.plot_table import value_table
from ces_identify.typesetting import minus
from ces_identify.validation.evaluate import Evaluation
from ces_observer.model import Model

SIZE = (550, 400)
BOX = (58.0, 34.0, 476.0, 276.0)
FLAT_HEIGHT = 312.0
SPEED = "Speed [m/s], positive in compression"
RAMP = (BOX[0], SIZE[1] - 38.0)
TABLE_CELLS = 12
QUARTERS = (0.0, 0.25, 0.5, 0.75, 1.0)


def coverage_map(
    ident: str, grid: SpeedCurrentGrid, filled: Sequence[Evaluation], outlined: Sequence[Evaluation], model: Model
) -> Markup:
    """Return the share of time [%] of `filled` in each cell, with the outline of the cells of `outlined`."""
    share, beside = grid.share(filled), grid.share(outlined)
    title = "Share of time over speed and current"
    if grid.one_current:
        text, label = "The current is constant.", "Share of time [%]"
        marks = [PlotBars("identification" if outlined else "", grid.speed, share[:, 0], "cover")]
        marks += [PlotBars("validation", grid.speed, beside[:, 0], "outline")] if outlined else []
        return _histogram(ident, "Share of time over speed", text, label, marks, _table(grid, share, text, label))
    p = _map_panel(grid)
    shade = np.sqrt(share / share.max())
    parts = [axes(p, SPEED, "Current [A]", 7, 6), _cells(p, grid, share, shade, "cover", " % of the time")]
    if outlined:
        parts += [_outline(p, grid, beside > 0.0), legend(p.x.stop, 23, [("outline", "validation")])]
    parts += [
        p.rect(*model.envelope.speed_m_s, "envelope", *model.envelope.current_A),
        ramp(*RAMP, [f * f * share.max() for f in QUARTERS], "cover", "%"),
    ]
    text = f"Largest share of a cell: {share.max():.3g} %."
    return svg(ident, SIZE, title, text, parts, values=True) + _table(grid, share, text, "Share of time [%]")


def error_map(
    ident: str,
    grid: SpeedCurrentGrid,
    evaluations: Sequence[Evaluation],
    identified: Sequence[Evaluation],
    model: Model,
) -> Markup:
    """Return the RMS error [N] of `evaluations` in each cell, with the outline of the cells of `identified`."""
    rms = grid.rms(evaluations)
    worst = float(np.nanmax(rms, initial=0.0)) or 1.0
    if grid.one_current:
        text, label = f"Largest: {worst:.3g} N.", "RMS error [N]"
        marks = [PlotBars("", grid.speed, rms[:, 0], "wrong")]
        return _histogram(ident, "RMS error over speed", text, label, marks, _table(grid, rms, text, label))
    p = _map_panel(grid)
    parts = [axes(p, SPEED, "Current [A]", 7, 6), _cells(p, grid, rms, rms / worst, "wrong", " N RMS error")]
    if identified:
        parts += [_outline(p, grid, grid.share(identified) > 0.0), legend(p.x.stop, 23, [("outline", "identified")])]
    if not np.isfinite(rms).any():
        parts.append(note(p, "no simulated force"))
    parts += [
        p.rect(*model.envelope.speed_m_s, "envelope", *model.envelope.current_A),
        ramp(*RAMP, [f * worst for f in QUARTERS], "wrong", "N"),
    ]
    text = f"Largest RMS error of a cell: {worst:.3g} N."
    figure = svg(ident, SIZE, "RMS error over speed and current", text, parts, values=True)
    return figure + _table(grid, rms, text, "RMS error [N]")


def _table(grid: SpeedCurrentGrid, values: F, text: str, head: str) -> Markup:
    """Return the cells with the highest values."""
    order = np.argsort(-np.nan_to_num(values), axis=None)[:TABLE_CELLS]
    rows = []
    for a, b in zip(*np.unravel_index(order, values.shape), strict=True):
        if values[a, b] > 0.0:
            speed, current = grid.speed[a : a + 2], grid.current[b : b + 2]
            ends = (f"{speed[0]:.3g} to {speed[1]:.3g}", f"{current[0]:.3g} to {current[1]:.3g}", f"{values[a, b]:.3g}")
            rows.append(tuple(map(minus, ends)))
    return value_table(f"{text} The {len(rows)} highest cells.", ("Speed [m/s]", "Current [A]", head), rows)


def _map_panel(grid: SpeedCurrentGrid) -> Panel:
    return panel((grid.speed[0], grid.speed[-1]), (grid.current[0], grid.current[-1]), BOX)


def _cells(p: Panel, grid: SpeedCurrentGrid, values: F, shade: F, css: str, unit: str) -> str:
    def describe(a: int, b: int) -> str:
        v, c = grid.speed[a : a + 2], grid.current[b : b + 2]
        return f"{v[0]:.3g} to {v[1]:.3g} m/s, {c[0]:.3g} to {c[1]:.3g} A: {values[a, b]:.3g}{unit}"

    return cells(p, (grid.speed, grid.current), values, shade, css, describe)


def _outline(p: Panel, grid: SpeedCurrentGrid, inside: Mask) -> str:
    """Return the boundary of the cells `inside`."""
    wide = np.pad(inside, 1)
    x, y = p.x.px(grid.speed), p.y.px(grid.current)
    upright = zip(*np.nonzero(wide[1:, 1:-1] != wide[:-1, 1:-1]), strict=True)
    level = zip(*np.nonzero(wide[1:-1, 1:] != wide[1:-1, :-1]), strict=True)
    d = [f"M{x[a]:.1f},{y[b]:.1f}V{y[b + 1]:.1f}" for a, b in upright]
    d += [f"M{x[a]:.1f},{y[b]:.1f}H{x[a + 1]:.1f}" for a, b in level]
    return f'<path class="outline" d="{"".join(d)}"/>' if d else ""


def _histogram(ident: str, title: str, text: str, y_label: str, marks: Sequence[PlotBars], table: Markup) -> Markup:
    """Return bars over speed."""
    top = max(float(np.nanmax(bars.values, initial=0.0)) for bars in marks) or 1.0
    area = PlotArea(y_label, marks, FLAT_HEIGHT, (0.0, 1.05 * top), y_ticks=6)
    return draw_plot(Plot(ident, title, text, SPEED, [area], float(SIZE[0]), x_ticks=7), table=table)
