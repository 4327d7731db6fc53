"""What a learned stroke leaves: its page with figures, `result.json`, the command, and an experiment that runs it."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ces_iterate.stroke.learning import (
    CONVERGED,
    DIVERGED,
    FIRST,
    LEARNED,
    REPEATED,
    LearnedStroke,
    LearningRun,
    command_peaks,
)
from ces_iterate.stroke.learning_filter import MAX_CONTRACTION
from ces_iterate.stroke.plan import StrokePlan, write_learned_experiment
from ces_observer.json_text import write_all_atomically
from ces_report.drawing import Panel, dots, label, legend, line, panel, svg, with_value
from ces_report.plot import Plot, PlotArea, PlotLine, draw_plot, value_table
from ces_report.shell import page_template, replace_unencodable
from ces_report.typesetting import three_figures

RUNS_SIZE = (440, 446)
FREQUENCY = "Frequency [Hz]"
WINDOW_S = 1.0
BEST_BAND = 1.5  # of the repeatability: the band in the figure of the runs
MANTISSAS = (1, 2, 5)
RUN_CSS = {FIRST: "before", LEARNED: "after", REPEATED: "again"}
MATERIAL_SHARE = 0.25  # of the squared error: what lies above the learning bandwidth is then worth a warning
SCHEMA = "ces-learned-stroke/1"
COMMAND, EXPERIMENT, RESULT, REPORT = "command.csv", "learned.yaml", "result.json", "report.html"


def write_results(folder: Path, plan: StrokePlan, learned: LearnedStroke, facts: Mapping[str, str]) -> None:
    """Write all four files into `folder`, or none; raises CesError if they cannot be written."""
    interval = learned.goal.interval_s
    rows = (f"{n * interval:.4f},{value:.9f}" for n, value in enumerate(learned.learned.command_m))
    write_all_atomically(
        {
            folder / COMMAND: "\n".join(["time_s,position_m", *rows]) + "\n",
            folder / EXPERIMENT: write_learned_experiment(plan, COMMAND),
            folder / RESULT: json.dumps(as_json(learned), indent=1) + "\n",
            folder / REPORT: stroke_page(learned, f"Learned stroke {plan.experiment.settings.name}", facts),
        }
    )


def as_json(learned: LearnedStroke) -> dict[str, Any]:
    """Return the outcome as plain JSON values; lengths in metres."""
    f = learned.learning_filter
    return {
        "schema": SCHEMA,
        "stopped": learned.stopped,
        "iterations": learned.iterations,
        "repeatability_m": learned.repeatability_m,
        "first_error_m": learned.first.error_m,
        "confirmed_error_m": learned.confirmation.error_m,
        "error_above_bandwidth_m": error_above_bandwidth(learned),
        "best_run": learned.best + 1,
        "runs": [
            {"kind": run.kind, "error_m": run.error_m, "gain": run.scale, "limited": run.limited}
            for run in learned.runs
        ],
        "filter": {
            "bandwidth_Hz": f.bandwidth_Hz,
            "model_tolerance": f.tolerance,
            "max_contraction": float(f.contraction.max()),
            "max_contraction_of_exact_model": float(f.nominal.max()),
        },
        "model": asdict(f.model),
        "limits": {
            name: {"wanted": wanted, "highest": highest, "limit": limit}
            for name, wanted, highest, limit in command_peaks(learned)
        },
        "warnings": list(find_warnings(learned)),
    }


def summary_sentence(learned: LearnedStroke) -> str:
    """Return what was reached, in one sentence."""
    errors_m = learned.first.error_m, learned.confirmation.error_m, learned.repeatability_m
    first, last, floor = (1e6 * error_m for error_m in errors_m)
    return (
        f"The tracking error fell from {first:.0f} to {last:.0f} µm RMS in {learned.iterations} iterations: "
        f"{100.0 * last / first:.1f} % of the first error, {last / floor:.2f} times the repeatability ({floor:.0f} µm)."
    )


def describe_kind(run: LearningRun) -> str:
    """Return what a run was, for tables."""
    return {FIRST: "wanted stroke", LEARNED: "learned command", REPEATED: "learned command, repeated"}[run.kind]


def find_warnings(learned: LearnedStroke) -> Iterator[str]:
    """Yield what the reader must know before using the command."""
    if learned.stopped == DIVERGED:
        yield "The error grew even with a small gain; the best command so far was kept. Check model and recordings."
    above = error_above_bandwidth(learned)
    if learned.stopped != CONVERGED and above**2 > MATERIAL_SHARE * learned.confirmation.error_m**2:
        yield (
            f"{1e6 * above:.0f} µm of the error lie above the learning bandwidth of "
            f"{learned.learning_filter.bandwidth_Hz:.0f} Hz, where convergence is not guaranteed. Measure the actuator "
            "(probe), raise probe.to_Hz, or lower model_tolerance."
        )
    if learned.runs[learned.best].limited > 0.0:
        yield "The limits changed the learned command; where they bind, the piston cannot follow."


def error_above_bandwidth(learned: LearnedStroke) -> float:
    """Return the RMS [m] of what repeats of the error above the learning bandwidth."""
    goal, bandwidth = learned.goal, learned.learning_filter.bandwidth_Hz
    frequency = np.fft.rfftfreq(len(goal.wanted_m), goal.interval_s)
    error, again = (
        np.fft.rfft(goal.wanted_m - run.position_m)[frequency > bandwidth]
        for run in (learned.learned, learned.confirmation)
    )
    repeating = float(np.sum((error * again.conj()).real))  # noise of the two runs is uncorrelated
    return float(np.sqrt(2.0 * max(repeating, 0.0))) / len(goal.wanted_m)


def stroke_page(learned: LearnedStroke, title: str, facts: Mapping[str, str]) -> str:
    """Return the page as text that is both HTML and well-formed XML; `facts` (date, command) follow the headline."""
    f, model = learned.learning_filter, learned.learning_filter.model
    points = len(learned.runs) * len(learned.goal.wanted_m)
    points += 0 if learned.probe is None else len(learned.probe.command_m)
    actuator = (
        f"gain {model.gain:.3f}, delay {1e3 * model.delay_s:.1f} ms, {model.bandwidth_Hz:.0f} Hz, "
        f"damping {model.damping:.2f}" + (f", {1e3 * model.valve_s:.1f} ms" if model.valve_s else "")
    )
    condition = (
        f"|Q(1 − LG)| < 1 holds at all frequencies for an actuator of which the model is wrong by "
        f"{100.0 * f.tolerance:.0f} % in gain, bandwidth and delay at once, "
        "and within the uncertainty of the measured response: at most "
        f"{f.contraction.max():.2f} (designed for {MAX_CONTRACTION}). Learning ends at {f.bandwidth_Hz:.0f} Hz."
    )
    page = page_template("stroke.html.j2", __package__, ("stroke.css",)).render(
        title=title,
        headline=summary_sentence(learned),
        warnings=list(find_warnings(learned)),
        facts={
            **facts,
            "Stopped": learned.stopped,
            "Runs": f"{len(learned.runs) + (learned.probe is not None)}, "
            f"{learned.goal.interval_s * points:.0f} s on the rig",
            "Actuator": actuator,
            "Learning bandwidth": f"{f.bandwidth_Hz:.0f} Hz",
        },
        runs_figure=_draw_runs(learned),
        tracking_figure=_draw_tracking(learned),
        robustness_figure=_draw_robustness(learned),
        condition=condition,
        limits=[(name, *(f"{value:.4g}" for value in row)) for name, *row in command_peaks(learned)],
        runs=[
            (
                str(number),
                describe_kind(run),
                three_figures(1e6 * run.error_m),
                three_figures(run.error_m / learned.repeatability_m),
                f"{run.scale:g}" if run.kind == LEARNED else "",
                f"{100.0 * run.limited:.1f}" if run.limited else "",
            )
            for number, run in enumerate(learned.runs, 1)
        ],
    )
    return replace_unencodable(page)


def _draw_runs(learned: LearnedStroke) -> Markup:
    """Return the RMS error [µm] of every run of the stroke, on a logarithmic axis, with the repeatability."""
    error = 1e6 * np.array([run.error_m for run in learned.runs])
    floor = 1e6 * learned.repeatability_m
    number = np.arange(1, len(error) + 1, dtype=np.float64)
    low, high = math.log10(min(floor, error.min()) / 1.6), math.log10(error.max() * 1.6)
    p = panel((0.5, len(error) + 0.5), (low, high), (52, 46, 376, 350))
    first = sum(run.kind == FIRST for run in learned.runs)
    learning = slice(max(first - 1, 0), len(error) - 1)
    values = []
    for n, run in enumerate(learned.runs, 1):
        dot = dots(p, np.array([float(n)]), np.log10([1e6 * run.error_m]), f"{RUN_CSS[run.kind]} spot")
        text = f"run {n}, {describe_kind(run)}: {1e6 * run.error_m:.0f} µm RMS"
        values.append(with_value(f"{p.rect(n - 0.5, n + 0.5, 'hit')}{dot}", text))
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
        *values,
        legend(p.x.stop + 8, 16, (("before", "first runs"), ("after", "learned"), ("again", "repeated"))),
        label(p.x.start + 6, float(p.y.px(math.log10(floor))) - 5, f"repeatability {floor:.0f} µm", "tick"),
    ]
    text = f"RMS tracking error of {len(error)} runs; line: repeatability, band: up to {BEST_BAND} times that."
    rows = [(f"{n}", describe_kind(run), f"{1e6 * run.error_m:.0f}") for n, run in enumerate(learned.runs, 1)]
    figure = svg("runs", RUNS_SIZE, "Error over the runs", text, parts, values=True)
    return figure + value_table(text, ("Run", "Kind", "RMS error [µm]"), rows)


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


def _draw_tracking(learned: LearnedStroke) -> Markup:
    """Return wanted and measured positions before and after learning, at first in a window, and both errors."""
    goal, first, last = learned.goal, learned.first, learned.confirmation
    total = np.concatenate([[0.0], np.cumsum((goal.wanted_m - first.position_m) ** 2)])
    length = min(len(goal.wanted_m), round(WINDOW_S / goal.interval_s))
    start = int(np.argmax(total[length:] - total[:-length]))  # of the window in which the error's power is largest
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
    view = float(time[start]), float(time[start + length - 1])
    title = "Tracking before and after learning"
    return draw_plot(Plot("tracking", title, text, "Time [s]", areas, width=660.0, x_view=view))


def _draw_robustness(learned: LearnedStroke) -> Markup:
    """Return the bounds on |Q (1 - L G)|, its value for an exact model, and Q, over the frequency."""
    f = learned.learning_filter
    frequency = f.frequency_Hz
    marks = [
        PlotLine("limit", frequency[[0, -1]], np.ones(2), "limit"),
        PlotLine("Q", frequency, f.share, "filter"),
        PlotLine("exact", frequency, f.nominal, "before"),
        PlotLine("measured", frequency, f.share * f.bound_measured, "again"),
        PlotLine(f"{100.0 * f.tolerance:.0f} % wrong", frequency, f.share * f.bound_in_tolerance, "after"),
    ]
    text = (
        f"|Q(1 - LG)| for all plants considered; it stays below 1, at most {f.contraction.max():.2f} "
        f"(allowed {MAX_CONTRACTION})."
    )
    area = PlotArea("Factor of the error from run to run", marks, 226.0, (0.0, 1.25), y_ticks=6)
    return draw_plot(Plot("robustness", "Condition of convergence", text, FREQUENCY, [area], 550.0, group="frequency"))
