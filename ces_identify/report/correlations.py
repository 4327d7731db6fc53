"""The figure of a residual's correlations: with itself, with each input and with its square, with their bands."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from ces_identify.numerics.arrays import F
from ces_identify.report.drawing import Panel, PlotAxis, label, svg
from ces_identify.report.plot_table import value_table
from ces_identify.typesetting import minus
from ces_identify.validation.residuals import Correlation, ResidualTests

COLUMNS = 5
PANEL = (176.0, 84.0)  # width and height [px]
GAP = (46.0, 58.0)
LEFT, TOP, BOTTOM = 44.0, 34.0, 40.0
HEADROOM = 1.15  # of the scale over the largest correlation or band


def correlation_figure(ident: str, tests: ResidualTests, name: str) -> Markup:
    """Return a small plot for each correlation of `tests`; those with inputs share a scale."""
    plots = (tests.whiteness, *tests.inputs)
    scale = HEADROOM * max([abs(c.values[c.worst]) for c in tests.inputs] + [c.band for c in tests.inputs] + [1e-3])
    rows = -(-len(plots) // COLUMNS)
    size = (LEFT + COLUMNS * PANEL[0] + (COLUMNS - 1) * GAP[0] + 12, TOP + rows * (PANEL[1] + GAP[1]) - GAP[1] + BOTTOM)
    parts = []
    for i, correlation in enumerate(plots):
        box = LEFT + i % COLUMNS * (PANEL[0] + GAP[0]), TOP + i // COLUMNS * (PANEL[1] + GAP[1])
        last = i + COLUMNS >= len(plots)
        parts.append(_plot(_panel(correlation, box, scale if i else 1.0), correlation, last))
    text = (
        "Correlation of the residual with itself, and of each input with the later residual, over the lag; the band "
        "holds 99 % of the values at a lag without correlation."
    )
    figure = svg(ident, size, f"Correlations of the residual, {name}", text, parts)
    heads = ("Correlation", "Largest", "at a lag of [ms]", "99 % band", "Significant over all lags")
    return Markup('<div class="wide">{}</div>{}').format(figure, value_table(text, heads, [_row(c) for c in plots]))


def _row(correlation: Correlation) -> tuple[str, ...]:
    """Return the row of a correlation in the table of the figure."""
    worst, lag_ms = correlation.values[correlation.worst], 1e3 * correlation.lags_s[correlation.worst]
    significant = "no" if correlation.passed else "yes"
    return _name(correlation), minus(f"{worst:.2f}"), f"{lag_ms:.3g}", f"±{correlation.band:.2g}", significant


def _name(correlation: Correlation) -> str:
    return "residual with itself" if correlation.first == "residual" else f"{correlation.first} → {correlation.second}"


def _panel(correlation: Correlation, box: tuple[float, float], scale: float) -> Panel:
    last = 1e3 * float(correlation.lags_s[-1])
    left, top = box
    return Panel(PlotAxis(0.0, last, left, left + PANEL[0]), PlotAxis(-scale, scale, top + PANEL[1], top))


def _plot(p: Panel, correlation: Correlation, last: bool) -> str:
    band = min(correlation.band, p.y.high)
    out = [p.rect(0.0, p.x.high, "chance", -band, band), _axes(p, last)]
    css = "error" if correlation.passed else "simulated"
    out.append(_stems(p, 1e3 * correlation.lags_s, correlation.values, f"{css} stems"))
    out.append(label(p.x.start, p.y.stop - 9, _name(correlation), "name"))
    return "\n".join(out)


def _axes(p: Panel, last: bool) -> str:
    out = []
    for value, text in p.y.three_ticks():
        y = float(p.y.px(value))
        out.append(f'<path class="{"grid" if value else "zero"}" d="M{p.x.start:.1f},{y:.1f}H{p.x.stop:.1f}"/>')
        out.append(label(p.x.start - 6, y + 4, text, "tick end"))
    for value, text in p.x.ticks(3):
        out.append(label(float(p.x.px(value)), p.y.start + 19, minus(text), "tick mid"))
    if last:
        out.append(label(p.x.stop, p.y.start + 34, "Lag [ms]", "name end"))
    return "\n".join(out)


def _stems(p: Panel, lags: F, values: F, css: str) -> str:
    zero = float(p.y.px(0.0))
    shown = np.arange(0, len(lags), max(1, len(lags) // int(PANEL[0] / 3)))  # no denser than the eye can resolve
    ends = zip(p.x.px(lags[shown]), p.y.px(values[shown]), strict=True)
    return f'<path class="{css}" d="{"".join(f"M{x:.1f},{zero:.1f}V{y:.1f}" for x, y in ends)}"/>'
