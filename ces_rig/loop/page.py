"""The page of an iteration: cost and coverage over the iterations, what is known, and each experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ces_data.arrays import F
from ces_identify.report.figures import coverage_map, error_map, make_grid
from ces_observer.json_text import write_atomically
from ces_report.plot import Plot, PlotArea, PlotDots, PlotLine, PlotMark, draw_plot
from ces_report.shell import PageHead, page_template, replace_unencodable
from ces_rig.experiments.commands import RigCommands, RigLimits
from ces_rig.loop.iterate import Iterations, evaluate_fresh
from ces_rig.loop.store import Iteration, Step

SECONDS = "Recorded time in all [s]"
WIDTH, HEIGHT = 550.0, 220.0
WIDE = 1120.0
COMMAND_POINTS = 20_000  # of stroke and of current, so that a page of many experiments stays small


def write_page(path: Path, iterations: Iterations) -> None:
    """Write the page of all finished iterations; raises CesError if it cannot be written."""
    done, plan = iterations.done, iterations.plan
    model, history = done.model, done.history
    assert model is not None
    evaluations = [evaluate_fresh(model, recording) for recording in (*iterations.given, *done.recordings)]
    runs = [(run, Step.open(iterations.out, run.number).read_commands()) for run in history if run.number > 0]
    grid, newest, kind = make_grid(evaluations, model.envelope), history[-1], plan.rig.get("kind", "")
    experiments = "1 experiment" if len(runs) == 1 else f"{len(runs)} experiments"
    target = f", target {plan.stop.target_J:g} %" if plan.stop.target_J else ""
    page = page_template("iterate.html.j2", "ces_rig.loop").render(
        head=PageHead(f"Iteration {path.absolute().parent.name}: {experiments} on the {kind} rig"),
        headline=_headline(history),
        facts={
            "Experiments": f"{plan.experiments.kind}, {plan.experiments.duration_s:g} s each",
            "Stops at": f"{plan.stop.budget_s:g} s recorded{target}",
            "Model": f"{model.structure.replace('_', ' ')}, {model.size}",
            "Rig": str(kind),
            "Seed": str(plan.seed),
        },
        history=history,
        validations=list(newest.validation_J),
        cost=_cost_chart(history),
        known=_coverage_chart(history),
        regions=newest.regions,
        maps={
            "coverage": coverage_map("coverage", grid, evaluations, [], model),
            "error": error_map("errors", grid, evaluations, [], model),
        },
        experiments=[
            _experiment(k, run, commands, plan.limits) for k, (run, commands) in enumerate(runs) if commands is not None
        ],
    )
    write_atomically(path, replace_unencodable(page))


def _headline(history: Sequence[Iteration]) -> str:
    newest, count = history[-1], sum(iteration.number > 0 for iteration in history)
    fresh = [iteration.fresh_J for iteration in history if iteration.fresh_J is not None]
    text = f"{count} experiments, {newest.total_s:.0f} s recorded: J = {newest.fit_J:.2f} % on all recordings together"
    if fresh:
        text += f"; the model before read J = {fresh[-1]:.2f} % on the newest recording, which it had not seen"
    return f"{text}. {100 * newest.coverage:.0f} % of the states within the limits are covered."


def _cost_chart(history: Sequence[Iteration]) -> Markup:
    """Return the costs over the recorded time: on the newest recording before it was used, and after the fit."""
    validation = [float(np.mean(list(iteration.validation_J.values()) or [np.nan])) for iteration in history]
    curves = {
        "fresh": (_finite([iteration.fresh_J for iteration in history]), "series s1"),
        "after the fit": (_finite([iteration.fit_J for iteration in history]), "series s0"),
        "validation": (_finite(validation), "error"),
    }
    shown = {name: curve for name, curve in curves.items() if np.isfinite(curve[0]).any()}
    top = 1.08 * max((float(np.nanmax(values)) for values, _ in shown.values()), default=1.0)
    text = f"Newest cost after the fit: {history[-1].fit_J:.2f} %."
    return _draw_progress("cost", "Cost over the iterations", text, "Cost J [%]", history, shown, top)


def _finite(values: Sequence[float | None]) -> F:
    """Return the values (n,), NaN where there is none or it is not finite."""
    array = np.array(values, np.float64)
    return np.where(np.isfinite(array), array, np.nan)


def _coverage_chart(history: Sequence[Iteration]) -> Markup:
    """Return over the recorded time the share of covered states and the error to expect."""
    shares = {
        "covered": (np.array([100.0 * iteration.coverage for iteration in history]), "curve c1"),
        "band": (np.array([100.0 * iteration.band for iteration in history]), "error"),
        "disagreement": (np.array([100.0 * iteration.disagreement for iteration in history]), "series s1"),
    }
    text = f"Covered: {shares['covered'][0][-1]:.0f} %."
    return _draw_progress("known", "What is known over the iterations", text, "Share [%]", history, shares, 104.0)


def _draw_progress(
    ident: str,
    title: str,
    text: str,
    y_label: str,
    history: Sequence[Iteration],
    curves: Mapping[str, tuple[F, str]],
    top: float,
) -> Markup:
    """Return curves (values, classes) by name over the recorded time, with a dot for each iteration."""
    at = np.array([iteration.total_s for iteration in history])
    marks: list[PlotMark] = [PlotLine(name, at, values, css) for name, (values, css) in curves.items()]
    marks += [PlotDots(name, at, values, f"{css} spot") for name, (values, css) in curves.items()]
    view = (0.0, 1.03 * max(float(at.max()), 1.0))
    area = PlotArea(y_label, marks, HEIGHT, (0.0, top))
    return draw_plot(Plot(ident, title, text, SECONDS, [area], WIDTH, x_view=view, group="progress", x_ticks=7))


def _experiment(number: int, iteration: Iteration, commands: RigCommands, limits: RigLimits) -> dict[str, Any]:
    """Return name, figure and peaks of an experiment."""
    time, stroke, current = commands.time_s, 1e3 * commands.stroke_m, commands.current_A
    areas = [
        PlotArea("Stroke [mm]", [PlotLine("stroke", time, stroke, "error")], 104.0, _range(stroke), y_ticks=4),
        PlotArea("Current [A]", [PlotLine("current", time, current, "series s1")], 54.0, _range(current), y_ticks=2),
    ]
    title, text = f"Stroke and current of {commands.name}", f"{commands.duration_s:g} s."
    plot = Plot(f"commands{number}", title, text, "Time [s]", areas, WIDE, x_ticks=9, legend=False)
    speed, acceleration = commands.motion()
    peaks = {
        "stroke": f"{1e3 * abs(commands.stroke_m - limits.centre_m).max():.1f} of {1e3 * limits.stroke_m:g} mm",
        "speed": f"{abs(speed).max():.2f} of {limits.speed_m_s:.3g} m/s",
        "acceleration": f"{abs(acceleration).max():.0f} of {limits.acceleration_m_s2:.3g} m/s²",
        "current": f"{current.min():.2f} to {current.max():.2f} A",
        "rest before": f"{iteration.rest_s:.0f} s",
        "heat load after": f"{iteration.load_W:.0f} W",
    }
    return {"name": iteration.name, "figure": draw_plot(plot, COMMAND_POINTS), "peaks": peaks}


def _range(values: F) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    return low - 0.08 * (high - low), high + 0.08 * (high - low)
