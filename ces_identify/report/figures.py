"""The two charts of a recording: force over speed, and force over time with its error."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from ces_identify.numerics.arrays import F, Mask
from ces_identify.report.plot import Plot, PlotArea, PlotBand, PlotDots, PlotLine, PlotMark, PlotShade, draw_plot
from ces_identify.report.window import Window
from ces_identify.validation.evaluate import Evaluation
from ces_observer.model import Model

MAX_DOTS = 2400  # of each force in a speed-force chart
OUTSIDE = "outside the envelope"


def speed_force(ident: str, evaluation: Evaluation, model: Model) -> Markup:
    """Return measured and simulated force [N] over speed [m/s] on the scored ticks."""
    series, run = evaluation.series, evaluation.run
    ticks = np.flatnonzero(series.scored)
    order = np.random.default_rng(0).permutation(len(ticks))[:MAX_DOTS]  # random: a stride would alias with a sine
    shown = ticks[order]
    marks: list[PlotMark] = [
        *_outside_speeds(evaluation, model),
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
    time, breaks = series.time_s, _restarts(evaluation)
    error = np.where(series.scored, series.force - run.force, np.nan)
    outside = [PlotShade(OUTSIDE, time, run.clamped)] if run.clamped.any() else []
    lines = [
        PlotLine("measured", time, series.force, "measured", breaks),
        PlotLine("simulated", time, run.force, "simulated", breaks),
    ]
    areas = [
        PlotArea("Force [N]", [*outside, *_band(evaluation), *lines], height=170.0),
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


def _band(evaluation: Evaluation) -> list[PlotBand]:
    half, force = evaluation.half_width, evaluation.run.force
    return [] if half is None else [PlotBand("band", evaluation.series.time_s, force - half, force + half, "bounds")]


def _outside_speeds(evaluation: Evaluation, model: Model) -> list[PlotShade]:
    """Return shades over speeds outside the model's envelope, on the sides that the recording reaches."""
    low, high = model.envelope.speed_m_s
    speed = evaluation.series.speed[evaluation.series.scored]
    below, above = (float(speed.min()), low), (high, float(speed.max()))
    return [_shade_between(a, b) for a, b in (below, above) if a < b]


def _shade_between(low: float, high: float) -> PlotShade:
    ends: F = np.array([low, high])
    return PlotShade(OUTSIDE, ends, np.ones(2, bool))


def _restarts(evaluation: Evaluation) -> Mask:
    breaks = np.zeros(len(evaluation.series), bool)
    breaks[evaluation.series.segments[:, 0]] = True
    return breaks
