"""Figures of an iteration: cost and coverage over the iterations, and stroke and current of each experiment."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from ces_identify.report.drawing import Panel, axes, label, legend, panel, svg
from ces_identify.report.marks import dots, line
from ces_iterate.commands import Commands
from ces_iterate.loop.store import Iteration

F = NDArray[np.float64]

SIZE = (550.0, 330.0)
BOX = (58.0, 44.0, 476.0, 220.0)
WIDE = (1120.0, 250.0)
UPPER, LOWER = (62.0, 30.0, 1040.0, 104.0), (62.0, 164.0, 1040.0, 44.0)
SECONDS = "Recorded time in all [s]"


def cost_chart(ident: str, history: Sequence[Iteration]) -> Markup:
    """Return the costs over the recorded time: on the newest recording before it was used, and after the fit."""
    at = np.array([one.total_s for one in history])
    fresh = np.array([np.nan if one.fresh_J is None else one.fresh_J for one in history])
    fit = np.array([one.fit_J for one in history])
    validation = np.array([np.mean(list(one.validation_J.values()) or [np.nan]) for one in history])
    curves = [(fresh, "simulated"), (fit, "measured"), (validation, "error")]
    shown = [(values, css) for values, css in curves if np.isfinite(values).any()]
    top = 1.08 * max(float(np.nanmax(values)) for values, _ in shown)
    p = panel((0.0, 1.03 * max(float(at.max()), 1.0)), (0.0, top), BOX)
    names = {"simulated": "fresh", "measured": "after the fit", "error": "validation"}
    parts = [axes(p, SECONDS, "Cost J [%]", 7, 5), legend(p.x.stop, 20, [(css, names[css]) for _, css in shown])]
    for values, css in shown:
        parts += _points(p, at, values, css)
    return svg(ident, SIZE, "Cost over the iterations", f"Newest cost after the fit: {fit[-1]:.2f} %.", parts)


def coverage_chart(ident: str, history: Sequence[Iteration]) -> Markup:
    """Return over the recorded time the share of covered states and the error to expect."""
    at = np.array([one.total_s for one in history])
    shares = {
        "c1": ("covered", np.array([100.0 * one.coverage for one in history])),
        "error": ("band", np.array([100.0 * one.band for one in history])),
        "simulated": ("disagreement", np.array([100.0 * one.disagreement for one in history])),
    }
    p = panel((0.0, 1.03 * max(float(at.max()), 1.0)), (0.0, 104.0), BOX)
    entries = [(f"curve {css}" if css == "c1" else css, name) for css, (name, _) in shares.items()]
    parts = [axes(p, SECONDS, "[%]", 7, 5), legend(p.x.stop, 20, entries)]
    for css, (_, values) in shares.items():
        parts += _points(p, at, values, f"curve {css}" if css == "c1" else css)
    return svg(ident, SIZE, "What is known over the iterations", f"Covered: {shares['c1'][1][-1]:.0f} %.", parts)


def commands_figure(ident: str, commands: Commands) -> Markup:
    """Return stroke and current of an experiment over time."""
    time, span = commands.time_s, (0.0, commands.duration_s)
    stroke, current = 1e3 * commands.stroke_m, commands.current_A
    above = panel(span, _range(stroke), UPPER)
    below = panel(span, _range(current), LOWER)
    parts = [
        axes(above, "", "Stroke [mm]", 9, 4),
        line(above, time, stroke, "measured thin"),
        axes(below, "", "Current [A]", 9, 2),
        line(below, time, current, "simulated"),
        *(
            label(float(below.x.px(at)), LOWER[1] + LOWER[3] + 17, f"{text} s", "tick mid")
            for at, text in below.x.ticks(9)
        ),
    ]
    return svg(ident, WIDE, f"Stroke and current of {commands.name}", f"{commands.duration_s:g} s.", parts)


def _points(p: Panel, x: F, y: F, css: str) -> list[str]:
    return [line(p, x, y, css), dots(p, x, y, f"{css} dots")]


def _range(values: F) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    return low - 0.08 * (high - low), high + 0.08 * (high - low)
