"""The two figures of a recording: force over speed, and force over time with its error."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from ces_identify.numerics.arrays import F, Mask
from ces_identify.report.drawing import Panel, around_zero, axes, legend, note, panel, span_of, svg
from ces_identify.report.marks import corridor, dots, line, shade
from ces_identify.report.window import Window
from ces_identify.validation.evaluate import Evaluation
from ces_observer.model import Model

MAX_DOTS = 2400  # of each force in a speed-force plot
LAYERS = 12  # of measured and simulated dots in turn, so that neither hides the other
BOTH = (("measured", "measured"), ("simulated", "simulated"))
SPEED_FORCE = (440, 446)
TIME = (660, 446)
NO_ERROR = "no scored tick has a simulated force"


def speed_force(ident: str, evaluation: Evaluation, model: Model) -> Markup:
    """Return measured and simulated force [N] over speed [m/s] on the scored ticks."""
    series, run = evaluation.series, evaluation.run
    ticks = np.flatnonzero(series.scored)
    order = np.random.default_rng(0).permutation(len(ticks))[:MAX_DOTS]  # random: a stride would alias with a sine
    shown = ticks[order]
    speed, measured, simulated = series.speed[shown], series.force[shown], run.force[shown]
    p = panel(span_of(series.speed[series.scored]), span_of(series.force[series.scored], simulated), (58, 34, 366, 362))
    parts = [_outside_speeds(p, evaluation, model), axes(p, "Speed [m/s], positive in compression", "Force [N]", 6, 7)]
    for some in np.array_split(np.arange(len(shown)), LAYERS):
        parts.append(dots(p, speed[some], measured[some], "measured dots"))
        parts.append(dots(p, speed[some], simulated[some], "simulated dots"))
    parts.append(legend(p.x.stop, 23, BOTH))
    text = f"Measured and simulated force over piston speed, {len(shown)} of {int(series.scored.sum())} scored ticks."
    return svg(ident, SPEED_FORCE, f"Speed-force plot of {evaluation.name}", text, parts)


def time_plot(ident: str, evaluation: Evaluation, window: Window) -> Markup:
    """Return forces and error over `window`, and the error over the whole run."""
    parts = [*_window_panels(evaluation, window), *_overview_panel(evaluation, window)]
    text = f"Window {window.why}. Below it the error, and at the bottom the error over the whole run."
    return svg(ident, TIME, f"Measured and simulated force over time, {evaluation.name}", text, parts)


def _window_panels(evaluation: Evaluation, window: Window) -> list[str]:
    series, run = evaluation.series, evaluation.run
    some = slice(window.start, window.stop)
    time, measured, simulated = series.time_s[some], series.force[some], run.force[some]
    breaks = _restarts(evaluation)[some]
    error = np.where(series.scored[some], measured - simulated, np.nan)
    span = (float(time[0]), float(time[-1]))
    width = np.zeros(0) if evaluation.half_width is None else evaluation.half_width[some]
    force = panel(span, span_of(measured, simulated), (58, 34, 586, 170))
    below = panel(span, around_zero(error), (58, 238, 586, 58))
    return [
        *(shade(p, time, run.clamped[some], "outside") for p in (force, below)),
        axes(force, "", "Force [N]", 8, 5),
        *_error_axes(below, "Time [s]", "Error, measured \N{MINUS SIGN} simulated [N]", error),
        *([corridor(force, time, simulated - width, simulated + width, "bounds")] if len(width) else []),
        line(force, time, measured, "measured", breaks),
        line(force, time, simulated, "simulated", breaks),
        line(below, time, error, "error", breaks),
        legend(force.x.stop, 23, (*BOTH, *([("bounds", "band")] if len(width) else []))),
    ]


def _overview_panel(evaluation: Evaluation, window: Window) -> list[str]:
    series, run = evaluation.series, evaluation.run
    time = series.time_s
    error = np.where(series.scored, series.force - run.force, np.nan)
    p = panel((float(time[0]), float(time[-1])), around_zero(error), (58, 360, 586, 46))
    return [
        shade(p, time, run.clamped, "outside"),
        p.rect(time[window.start], time[window.stop - 1], "window"),
        *_error_axes(p, "Time [s], whole run", "Error over the whole run [N]", error),
        line(p, time, error, "error thin", _restarts(evaluation)),
    ]


def _error_axes(p: Panel, x_label: str, y_label: str, error: F) -> list[str]:
    if np.isfinite(error).any():
        return [axes(p, x_label, y_label, 8, None)]
    return [axes(p, x_label, y_label, 8, 0), note(p, NO_ERROR)]


def _outside_speeds(p: Panel, evaluation: Evaluation, model: Model) -> str:
    """Return a shade over speeds outside the model's envelope, on the sides that the recording reaches."""
    low, high = model.envelope.speed_m_s
    speed = evaluation.series.speed[evaluation.series.scored]
    below = p.rect(p.x.low, min(low, p.x.high), "outside") if speed.min() < low else ""
    return below + (p.rect(max(high, p.x.low), p.x.high, "outside") if speed.max() > high else "")


def _restarts(evaluation: Evaluation) -> Mask:
    breaks = np.zeros(len(evaluation.series), bool)
    breaks[evaluation.series.segments[:, 0]] = True
    return breaks
