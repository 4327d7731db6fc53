"""Figures of an iteration: cost and coverage over the iterations, and stroke and current of each experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from ces_identify.report.plot import Plot, PlotArea, PlotDots, PlotLine, PlotMark, draw_plot
from ces_iterate.commands import RigCommands
from ces_iterate.loop.store import Iteration

F = NDArray[np.float64]

SECONDS = "Recorded time in all [s]"
WIDTH, HEIGHT = 550.0, 220.0
WIDE = 1120.0
COMMAND_POINTS = 20_000  # of stroke and of current, so that a page of many experiments stays small


def cost_chart(ident: str, history: Sequence[Iteration]) -> Markup:
    """Return the costs over the recorded time: on the newest recording before it was used, and after the fit."""
    fresh = np.array([np.nan if one.fresh_J is None else one.fresh_J for one in history])
    fit = np.array([one.fit_J for one in history])
    validation = np.array([np.mean(list(one.validation_J.values()) or [np.nan]) for one in history])
    curves = {"fresh": (fresh, "series s1"), "after the fit": (fit, "series s0"), "validation": (validation, "error")}
    shown = {name: curve for name, curve in curves.items() if np.isfinite(curve[0]).any()}
    top = 1.08 * max(float(np.nanmax(values)) for values, _ in shown.values())
    text = f"Newest cost after the fit: {fit[-1]:.2f} %."
    return _progress(ident, "Cost over the iterations", text, "Cost J [%]", history, shown, top)


def coverage_chart(ident: str, history: Sequence[Iteration]) -> Markup:
    """Return over the recorded time the share of covered states and the error to expect."""
    shares = {
        "covered": (np.array([100.0 * one.coverage for one in history]), "curve c1"),
        "band": (np.array([100.0 * one.band for one in history]), "error"),
        "disagreement": (np.array([100.0 * one.disagreement for one in history]), "series s1"),
    }
    text = f"Covered: {shares['covered'][0][-1]:.0f} %."
    return _progress(ident, "What is known over the iterations", text, "Share [%]", history, shares, 104.0)


def commands_figure(ident: str, commands: RigCommands) -> Markup:
    """Return stroke and current of an experiment over time."""
    time, stroke, current = commands.time_s, 1e3 * commands.stroke_m, commands.current_A
    areas = [
        PlotArea("Stroke [mm]", [PlotLine("stroke", time, stroke, "error")], 104.0, _range(stroke), y_ticks=4),
        PlotArea("Current [A]", [PlotLine("current", time, current, "series s1")], 54.0, _range(current), y_ticks=2),
    ]
    title = f"Stroke and current of {commands.name}"
    plot = Plot(ident, title, f"{commands.duration_s:g} s.", "Time [s]", areas, WIDE, x_ticks=9, legend=False)
    return draw_plot(plot, COMMAND_POINTS)


def _progress(
    ident: str,
    title: str,
    text: str,
    y_label: str,
    history: Sequence[Iteration],
    curves: Mapping[str, tuple[F, str]],
    top: float,
) -> Markup:
    """Return curves (values, classes) by name over the recorded time, with a dot for each iteration."""
    at = np.array([one.total_s for one in history])
    marks: list[PlotMark] = [PlotLine(name, at, values, css) for name, (values, css) in curves.items()]
    marks += [PlotDots(name, at, values, f"{css} spot") for name, (values, css) in curves.items()]
    view = (0.0, 1.03 * max(float(at.max()), 1.0))
    area = PlotArea(y_label, marks, HEIGHT, (0.0, top))
    return draw_plot(Plot(ident, title, text, SECONDS, [area], WIDTH, x_view=view, group="progress", x_ticks=7))


def _range(values: F) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    return low - 0.08 * (high - low), high + 0.08 * (high - low)
