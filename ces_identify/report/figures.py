"""The figures of a model's evaluations: force over speed and time, correlations of the residual, maps.

Force over time shows first a window where the damper works and the error is typical. The maps show time and error over
speed and current.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from ces_data.arrays import F, Mask
from ces_identify.validation.evaluate import Evaluation, find_working_windows
from ces_identify.validation.residuals import Correlation, ResidualTests
from ces_observer.model import Envelope, Model
from ces_report.drawing import Panel, axes, cells, legend, note, panel, ramp, svg
from ces_report.plot import Plot, PlotArea, PlotBand, PlotDots, PlotLine, PlotMark, PlotShade, draw_plot, value_table
from ces_report.typesetting import minus

LENGTH_S = 1.5
BEFORE_EXIT = 0.8  # share of the window
MAX_DOTS = 2400  # of each force in a speed-force chart
OUTSIDE = "outside the envelope"
COLUMNS = 5
WIDTH, HEIGHT = 1120.0, 84.0  # of the figure, and of a correlation [px]
HEADROOM = 1.15  # of the scale over the largest correlation or band
HEADS = ("Correlation", "Largest", "at a lag of [ms]", "99 % band", "Significant over all lags")
SPEEDS, CURRENTS = 30, 14  # cells
MIN_TICKS = 10  # of a cell with an error
MIN_SPAN = 0.05  # [m/s, A] of a map
SIZE = (550, 400)
BOX = (58.0, 34.0, 476.0, 276.0)
SPEED = "Speed [m/s], positive in compression"
RAMP = (BOX[0], SIZE[1] - 38.0)
TABLE_CELLS = 12
QUARTERS = (0.0, 0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True)
class Window:
    """Ticks [start, stop) and the reason for them in words."""

    start: int
    stop: int
    why: str


def choose_window(evaluation: Evaluation) -> Window:
    """Return the window of LENGTH_S in which the damper works and whose local J is nearest the median of such windows.

    The local J is 100 times the RMS error in the window over the standard deviation of the whole scored force. A run
    whose force leaves its envelope shows where.
    """
    series, run = evaluation.series, evaluation.run
    length = max(2, round(LENGTH_S * series.rate_Hz))
    if length >= len(series):
        return Window(0, len(series), "the whole run")
    if len(exits := np.flatnonzero(run.held | ~np.isfinite(run.force))):
        start = int(np.clip(exits[0] - BEFORE_EXIT * length, 0, len(series) - length))
        return Window(start, start + length, f"where the force left its envelope, at {series.time_s[exits[0]]:.2f} s")
    squares = (series.force - run.force) ** 2
    starts, means = find_working_windows(length, series.scored, series.force, series.speed, squares)
    local = 100.0 * np.sqrt(means) / series.force[series.scored].std()
    typical = int(np.argmin(np.abs(local - np.median(local))))
    start = int(starts[typical])
    why = f"typical: local J {local[typical]:.1f} %, median {np.median(local):.1f} %, worst {local.max():.1f} %"
    return Window(start, start + length, why)


def speed_force(ident: str, evaluation: Evaluation, model: Model) -> Markup:
    """Return measured and simulated force [N] over speed [m/s] on the scored ticks."""
    series, run = evaluation.series, evaluation.run
    ticks = np.flatnonzero(series.scored)
    order = np.random.default_rng(0).permutation(len(ticks))[:MAX_DOTS]  # random: a stride would alias with a sine
    shown = ticks[order]
    speed, (low, high) = series.speed[ticks], model.envelope.speed_m_s
    outside = [(a, b) for a, b in ((float(speed.min()), low), (high, float(speed.max()))) if a < b]
    marks: list[PlotMark] = [
        *(PlotShade(OUTSIDE, np.array(ends), np.ones(2, bool)) for ends in outside),
        PlotDots("measured", series.speed[shown], series.force[shown], "measured dots"),
        PlotDots("simulated", series.speed[shown], run.force[shown], "simulated dots"),
    ]
    plot = Plot(
        ident=ident,
        title=f"Speed-force plot of {evaluation.name}",
        text=f"Measured and simulated force over piston speed, {len(shown)} of {len(ticks)} scored ticks.",
        x_label="Speed [m/s], positive in compression",
        areas=[PlotArea("Force [N]", marks, height=366.0, y_ticks=7)],
        width=440.0,
        free=True,
        x_ticks=6,
    )
    return draw_plot(plot)


def time_plot(ident: str, evaluation: Evaluation, window: Window, max_points: int) -> Markup:
    """Return forces and error of the whole run, at first over `window`, and the error over the whole run.

    Each line has at most `max_points` points.
    """
    series, run = evaluation.series, evaluation.run
    time, breaks, half = series.time_s, np.zeros(len(series), bool), evaluation.half_width
    breaks[series.segments[:, 0]] = True
    error = np.where(series.scored, series.force - run.force, np.nan)
    outside = [PlotShade(OUTSIDE, time, run.clamped)] if run.clamped.any() else []
    band = [] if half is None else [PlotBand("band", time, run.force - half, run.force + half, "bounds")]
    lines = [
        PlotLine("measured", time, series.force, "measured", breaks),
        PlotLine("simulated", time, run.force, "simulated", breaks),
    ]
    areas = [
        PlotArea("Force [N]", [*outside, *band, *lines], height=170.0),
        PlotArea(
            "Error, measured \N{MINUS SIGN} simulated [N]",
            [*outside, PlotLine("error", time, error, "error", breaks)],
            height=58.0,
            around_zero=True,
        ),
        PlotArea(
            "Error over the whole run [N]",
            [*outside, PlotLine("", time, error, "error thin", breaks)],
            height=46.0,
            around_zero=True,
            whole=True,
        ),
    ]
    plot = Plot(
        ident=ident,
        title=f"Measured and simulated force over time, {evaluation.name}",
        text=f"Shown at first: {window.why}. Below it the error, and at the bottom the error over the whole run.",
        x_label="Time [s]",
        areas=areas,
        x_view=(float(time[window.start]), float(time[window.stop - 1])),
    )
    return draw_plot(plot, max_points)


def count_lines(evaluation: Evaluation) -> int:
    """Return the number of lines with a value for each tick in the time plot of a recording."""
    return 3 if evaluation.half_width is None else 5


def correlation_figure(ident: str, tests: ResidualTests, name: str) -> Markup:
    """Return a small plot for each correlation of `tests`; those with inputs share a scale."""
    every = (tests.whiteness, *tests.inputs)
    scale = HEADROOM * max([abs(c.values[c.worst]) for c in tests.inputs] + [c.band for c in tests.inputs] + [1e-3])
    text = (
        "Correlation of the residual with itself, and of each input with the later residual, over the lag; the band "
        "holds 99 % of the values at a lag without correlation."
    )
    plot = Plot(
        ident,
        f"Correlations of the residual, {name}",
        text,
        "Lag [ms]",
        [_area(correlation, scale if i else 1.0) for i, correlation in enumerate(every)],
        WIDTH,
        group="lags",
        x_ticks=3,
        legend=False,
        columns=COLUMNS,
    )
    table = value_table(text, HEADS, [_row(correlation) for correlation in every])
    return Markup('<div class="wide">{}</div>').format(draw_plot(plot, table=table))


def _row(correlation: Correlation) -> tuple[str, ...]:
    """Return the row of a correlation in the table of the figure."""
    worst, lag_ms = correlation.values[correlation.worst], 1e3 * correlation.lags_s[correlation.worst]
    significant = "no" if correlation.passed else "yes"
    return _name(correlation), minus(f"{worst:.2f}"), f"{lag_ms:.3g}", f"±{correlation.band:.2g}", significant


def _name(correlation: Correlation) -> str:
    return "residual with itself" if correlation.first == "residual" else f"{correlation.first} → {correlation.second}"


def _area(correlation: Correlation, scale: float) -> PlotArea:
    """Return the area of a correlation over its lags; a star marks a significant one, which has its own colour, too."""
    lags, band = 1e3 * correlation.lags_s, min(correlation.band, scale)
    ends = lags[[0, -1]]
    css, star = ("error", "") if correlation.passed else ("simulated", " *")
    marks: list[PlotMark] = [
        PlotBand("", ends, np.full(2, -band), np.full(2, band), "chance"),
        PlotLine("", lags, correlation.values, css),
    ]
    return PlotArea(f"{_name(correlation)}{star}", marks, HEIGHT, (-scale, scale), around_zero=True)


@dataclass(frozen=True)
class SpeedCurrentGrid:
    """Edges of the cells in speed [m/s] and current [A], as (SPEEDS + 1,) and (CURRENTS + 1,)."""

    speed: F
    current: F

    def share(self, evaluations: Sequence[Evaluation]) -> F:
        """Return the share of the scored time [%] spent in each cell, shape (speeds, currents)."""
        ticks = sum((self._sum(e, e.series.scored) for e in evaluations), start=self._zeros())
        return np.asarray(100.0 * ticks / max(float(ticks.sum()), 1.0))

    def rms(self, evaluations: Sequence[Evaluation]) -> F:
        """Return the RMS error [N] in each cell, NaN where there are too few ticks."""
        ticks, squares = self._zeros(), self._zeros()
        for e in evaluations:
            mask = e.series.scored & np.isfinite(e.run.force)
            ticks += self._sum(e, mask)
            squares += self._sum(e, mask, (e.series.force[mask] - e.run.force[mask]) ** 2)
        return np.where(ticks >= MIN_TICKS, np.sqrt(squares / np.maximum(ticks, 1.0)), np.nan)

    def _sum(self, e: Evaluation, mask: Mask, weights: F | None = None) -> F:
        edges = (self.speed, self.current)
        return np.histogram2d(e.series.speed[mask], e.series.current[mask], bins=edges, weights=weights)[0]

    def _zeros(self) -> F:
        return np.zeros((len(self.speed) - 1, len(self.current) - 1))


def make_grid(evaluations: Sequence[Evaluation], envelope: Envelope) -> SpeedCurrentGrid:
    """Return a grid over the model's envelope and all speeds and currents of the scored ticks."""
    speed = np.concatenate([e.series.speed[e.series.scored] for e in evaluations])
    current = np.concatenate([e.series.current[e.series.scored] for e in evaluations])
    speeds, currents = np.append(speed, envelope.speed_m_s), np.append(current, envelope.current_A)
    return SpeedCurrentGrid(_edges(speeds, SPEEDS), _edges(currents, CURRENTS))


def _edges(values: F, cells: int) -> F:
    """Return the edges of cells over all `values`, the outer ones at least MIN_SPAN apart."""
    low = float(values.min())
    return np.linspace(low, max(float(values.max()), low + MIN_SPAN), cells + 1)


def coverage_map(
    ident: str, grid: SpeedCurrentGrid, filled: Sequence[Evaluation], outlined: Sequence[Evaluation], model: Model
) -> Markup:
    """Return the share of time [%] of `filled` in each cell, with the outline of the cells of `outlined`."""
    share, beside = grid.share(filled), grid.share(outlined)
    title = "Share of time over speed and current"
    p = panel((grid.speed[0], grid.speed[-1]), (grid.current[0], grid.current[-1]), BOX)
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
    p = panel((grid.speed[0], grid.speed[-1]), (grid.current[0], grid.current[-1]), BOX)
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
