"""The distribution of time and error over speed and current: the numbers of the maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from ces_data.arrays import F, Mask
from ces_identify.validation.evaluate import Evaluation
from ces_observer.model import Envelope, Model
from ces_report.drawing import Panel, axes, cells, legend, note, panel, ramp, svg
from ces_report.plot import Plot, PlotArea, PlotBars, draw_plot, value_table
from ces_report.typesetting import minus

SPEEDS, CURRENTS = 30, 14  # cells
MIN_TICKS = 10  # of a cell with an error
SAME_CURRENT = 0.01  # of the largest current: a narrower range counts as constant
SIZE = (550, 400)
BOX = (58.0, 34.0, 476.0, 276.0)
FLAT_HEIGHT = 312.0
SPEED = "Speed [m/s], positive in compression"
RAMP = (BOX[0], SIZE[1] - 38.0)
TABLE_CELLS = 12
QUARTERS = (0.0, 0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True)
class SpeedCurrentGrid:
    """Edges of the cells in speed [m/s] and current [A], as (SPEEDS + 1,) and (CURRENTS + 1,); (2,) if constant."""

    speed: F
    current: F

    @property
    def one_current(self) -> bool:
        """Whether the current is constant, so that the maps show speed only."""
        return len(self.current) == 2

    def share(self, evaluations: Sequence[Evaluation]) -> F:
        """Return the share of the scored time [%] spent in each cell, shape (speeds, currents)."""
        ticks = sum((self._sum(e, e.series.scored, None) for e in evaluations), start=self._zeros())
        return np.asarray(100.0 * ticks / max(float(ticks.sum()), 1.0))

    def rms(self, evaluations: Sequence[Evaluation]) -> F:
        """Return the RMS error [N] in each cell, NaN where there are too few ticks."""
        ticks, squares = self._zeros(), self._zeros()
        for e in evaluations:
            mask = e.series.scored & np.isfinite(e.run.force)
            ticks += self._sum(e, mask, None)
            squares += self._sum(e, mask, (e.series.force[mask] - e.run.force[mask]) ** 2)
        enough = ticks >= MIN_TICKS
        return np.where(enough, np.sqrt(squares / np.maximum(ticks, 1.0)), np.nan)

    def _sum(self, evaluation: Evaluation, mask: Mask, weights: F | None) -> F:
        series = evaluation.series
        edges = (self.speed, self.current)
        return np.histogram2d(series.speed[mask], series.current[mask], bins=edges, weights=weights)[0]

    def _zeros(self) -> F:
        return np.zeros((len(self.speed) - 1, len(self.current) - 1))


def make_grid(evaluations: Sequence[Evaluation], envelope: Envelope) -> SpeedCurrentGrid:
    """Return a grid over the model's envelope and all speeds and currents of the scored ticks."""
    speed = np.concatenate([e.series.speed[e.series.scored] for e in evaluations])
    current = np.concatenate([e.series.current[e.series.scored] for e in evaluations])
    speed, low, high = np.append(speed, envelope.speed_m_s), float(current.min()), float(current.max())
    if high - low <= SAME_CURRENT * max(abs(low), abs(high), 1e-9):
        currents = np.array([low - 1e-6, high + 1e-6])
    else:
        currents = _edges(min(low, envelope.current_A[0]), max(high, envelope.current_A[1]), CURRENTS)
    return SpeedCurrentGrid(_edges(speed.min(), speed.max(), SPEEDS), currents)


def _edges(low: float, high: float, cells: int) -> F:
    return np.linspace(low, max(high, low + 1e-9), cells + 1)


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
