"""The figures of a learned stroke: errors over the runs, tracking before and after, robustness, actuator's response."""

from __future__ import annotations

import math

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from ces_identify.report.drawing import Panel, label, legend, panel, svg, with_value
from ces_identify.report.marks import dots, line
from ces_identify.report.plot import Plot, PlotArea, PlotDots, PlotLine, draw_plot
from ces_identify.report.plot_table import value_table
from ces_iterate.stroke.goal import FIRST, LEARNED, REPEATED, LearnedStroke, LearningRun
from ces_iterate.stroke.learning_filter import MAX_CONTRACTION

Array = NDArray[np.float64]

RUNS_SIZE = (440, 446)
FREQUENCY = "Frequency [Hz]"
WINDOW_S = 1.0
BEST_BAND = 1.5  # of the repeatability: the band in the figure of the runs
MANTISSAS = (1, 2, 5)
RUN_CSS = {FIRST: "before", LEARNED: "after", REPEATED: "again"}


def draw_runs(learned: LearnedStroke) -> Markup:
    """Return the RMS error [µm] of every run of the stroke, on a logarithmic axis, with the repeatability."""
    error = 1e6 * np.array([run.error_m for run in learned.runs])
    floor = 1e6 * learned.repeatability_m
    number = np.arange(1, len(error) + 1, dtype=np.float64)
    low, high = math.log10(min(floor, error.min()) / 1.6), math.log10(error.max() * 1.6)
    p = panel((0.5, len(error) + 0.5), (low, high), (52, 46, 376, 350))
    first = sum(run.kind == FIRST for run in learned.runs)
    learning = slice(max(first - 1, 0), len(error) - 1)
    parts = [
        p.rect(p.x.low, p.x.high, "repeats", low, math.log10(BEST_BAND * floor)),
        _log_axis(p, "RMS error [µm]"),
        *(
            label(float(p.x.px(n)), p.y.start + 17, f"{n:.0f}", "tick mid")
            for n in number[:: max(1, len(number) // 12)]
        ),
        label(p.x.stop, p.y.start + 38, "Run of the stroke", "name end"),
        line(p, np.array([p.x.low, p.x.high]), np.full(2, math.log10(floor)), "floor"),
        line(p, number[learning], np.log10(error[learning]), "after"),
        *(_run_value(p, n, run) for n, run in enumerate(learned.runs, 1)),
        legend(p.x.stop + 8, 16, (("before", "first runs"), ("after", "learned"), ("again", "repeated"))),
        label(p.x.start + 6, float(p.y.px(math.log10(floor))) - 5, f"repeatability {floor:.0f} µm", "tick"),
    ]
    text = f"RMS tracking error of {len(error)} runs; line: repeatability, band: up to {BEST_BAND} times that."
    rows = [(f"{n}", describe_kind(run), f"{1e6 * run.error_m:.0f}") for n, run in enumerate(learned.runs, 1)]
    figure = svg("runs", RUNS_SIZE, "Error over the runs", text, parts, values=True)
    return figure + value_table(text, ("Run", "Kind", "RMS error [µm]"), rows)


def _run_value(p: Panel, number: int, run: LearningRun) -> str:
    """Return the dot of a run with its values."""
    error = 1e6 * run.error_m
    dot = dots(p, np.array([float(number)]), np.log10([error]), f"{RUN_CSS[run.kind]} spot")
    column = p.rect(number - 0.5, number + 0.5, "hit")
    return with_value(f"{column}{dot}", f"run {number}, {describe_kind(run)}: {error:.0f} µm RMS")


def draw_tracking(learned: LearnedStroke) -> Markup:
    """Return wanted and measured positions before and after learning, at first in a window, and both errors."""
    goal, first, last = learned.goal, learned.first, learned.confirmation
    some = _worst_window(goal.wanted_m - first.position_m, goal.interval_s)
    time = np.arange(len(goal.wanted_m), dtype=np.float64) * goal.interval_s
    wanted, before, after = (1e3 * values for values in (goal.wanted_m, first.position_m, last.position_m))
    positions = [
        PlotLine("wanted", time, wanted, "wanted"),
        PlotLine("before", time, before, "before"),
        PlotLine("after", time, after, "after"),
    ]
    error, rest = wanted - before, 1e3 * (wanted - after)
    areas = [
        PlotArea("Position [mm]", positions, height=150.0),
        PlotArea("Error before [mm]", [PlotLine("before", time, error, "before thin")], 56.0, around_zero=True),
        PlotArea("Error after [µm]", [PlotLine("after", time, rest, "after thin")], 48.0, around_zero=True),
    ]
    text = "At first the second with the largest first error. The wanted stroke lies below the curve after learning."
    view = float(time[some][0]), float(time[some][-1])
    title = "Tracking before and after learning"
    return draw_plot(Plot("tracking", title, text, "Time [s]", areas, width=660.0, x_view=view))


def draw_robustness(learned: LearnedStroke) -> Markup:
    """Return the bounds on |Q (1 - L G)|, its value for an exact model, and Q, over the frequency."""
    f = learned.learning_filter
    frequency = f.frequency_Hz
    measured = f.share * f.bound_measured if learned.measured is not None else None
    marks = [
        PlotLine("limit", frequency[[0, -1]], np.ones(2), "limit"),
        PlotLine("Q", frequency, f.share, "filter"),
        PlotLine("exact", frequency, f.nominal, "before"),
        *([PlotLine("measured", frequency, measured, "again")] if measured is not None else []),
        PlotLine(f"{100.0 * f.tolerance:.0f} % wrong", frequency, f.share * f.bound_in_tolerance, "after"),
    ]
    text = (
        f"|Q(1 - LG)| for all plants considered; it stays below 1, at most {f.contraction.max():.2f} "
        f"(allowed {MAX_CONTRACTION})."
    )
    area = PlotArea("Factor of the error from run to run", marks, 226.0, (0.0, 1.25), y_ticks=6)
    return draw_plot(Plot("robustness", "Condition of convergence", text, FREQUENCY, [area], 550.0, group="frequency"))


def draw_response(learned: LearnedStroke) -> Markup:
    """Return gain and phase of the actuator, measured in bands and modelled, over the frequency."""
    f, measured = learned.learning_filter, learned.measured
    frequency = f.frequency_Hz[1:]
    model = f.model.response(frequency)
    at = frequency[:0] if measured is None else measured.frequency_Hz
    found = model[:0] if measured is None else measured.response
    phase = np.degrees(np.unwrap(np.angle(model)))
    found_phase = np.degrees(np.angle(found / f.model.response(at))) + np.interp(at, frequency, phase)
    top = 1.1 * float(max(np.abs(model).max(), np.abs(found).max(initial=0.0)))
    gains = _model_and_measured(frequency, np.abs(model), at, np.abs(found))
    phases = _model_and_measured(frequency, phase, at, found_phase)
    areas = [PlotArea("Gain", gains, 96.0, (0.0, top), y_ticks=4), PlotArea("Phase [°]", phases, 86.0, y_ticks=4)]
    text = "Position over command: gain and phase."
    return draw_plot(Plot("response", "Response of the actuator", text, FREQUENCY, areas, 550.0, group="frequency"))


def _model_and_measured(x: Array, model: Array, at: Array, found: Array) -> list[PlotLine | PlotDots]:
    dots = [PlotDots("measured", at, found, "after spot small")] if len(at) else []
    return [PlotLine("model", x, model, "before"), *dots]


def _worst_window(error: Array, interval_s: float) -> slice:
    """Return the WINDOW_S in which the error's power is largest."""
    length = min(len(error), round(WINDOW_S / interval_s))
    total = np.concatenate([[0.0], np.cumsum(error**2)])
    start = int(np.argmax(total[length:] - total[:-length]))
    return slice(start, start + length)


def _log_axis(p: Panel, name: str) -> str:
    """Return grid lines and labels at 1, 2 and 5 of each decade of an axis of decimal logarithms."""
    out = [label(4, p.y.stop - 11, name, "name")]
    for decade in range(math.floor(p.y.low), math.ceil(p.y.high) + 1):
        for mantissa in MANTISSAS:
            value = decade + math.log10(mantissa)
            if p.y.low <= value <= p.y.high:
                y = float(p.y.px(value))
                out.append(f'<path class="grid" d="M{p.x.start:.1f},{y:.1f}H{p.x.stop:.1f}"/>')
                out.append(label(p.x.start - 7, y + 4, f"{mantissa * 10.0**decade:g}", "tick end"))
    return "\n".join(out)


def describe_kind(run: LearningRun) -> str:
    """Return what a run was, for tables."""
    return {FIRST: "wanted stroke", LEARNED: "learned command", REPEATED: "learned command, repeated"}[run.kind]
