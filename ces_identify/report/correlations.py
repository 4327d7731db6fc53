"""The figure of a residual's correlations: with itself, with each input and with its square, with their bands."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from ces_identify.report.plot import Plot, PlotArea, PlotBand, PlotLine, PlotMark, draw_plot
from ces_identify.report.plot_table import value_table
from ces_identify.typesetting import minus
from ces_identify.validation.residuals import Correlation, ResidualTests

COLUMNS = 5
WIDTH, HEIGHT = 1120.0, 84.0  # of the figure, and of a correlation [px]
HEADROOM = 1.15  # of the scale over the largest correlation or band
HEADS = ("Correlation", "Largest", "at a lag of [ms]", "99 % band", "Significant over all lags")


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
