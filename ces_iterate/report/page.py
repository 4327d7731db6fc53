"""Figures of an iteration: cost and coverage over the iterations, and stroke and current of each experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ces_data.arrays import F
from ces_identify.report.maps import coverage_map, error_map, make_grid
from ces_identify.validation.evaluate import Evaluation
from ces_iterate.commands import RigCommands
from ces_iterate.loop.identification import evaluate_fresh
from ces_iterate.loop.iterate import Iterations
from ces_iterate.loop.store import Iteration, Step
from ces_iterate.plan import Plan, RigLimits
from ces_observer.json_text import write_atomically
from ces_observer.model import Model
from ces_report.plot import Plot, PlotArea, PlotDots, PlotLine, PlotMark, draw_plot
from ces_report.shell import page_template, replace_unencodable

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


def write_page(path: Path, iterations: Iterations) -> None:
    """Write the page of all finished iterations; raises CesError if it cannot be written."""
    done = iterations.done
    assert done.model is not None
    evaluations = [evaluate_fresh(done.model, one) for one in (*iterations.given, *done.recordings)]
    experiments = [Step.open(iterations.out, one.number).read_commands() for one in done.history if one.number > 0]
    page = page_template("iterate.html.j2", "ces_iterate.report").render(
        title=_title(path, iterations.plan, len(experiments)),
        headline=headline(done.history),
        facts=facts(iterations.plan, done.model),
        history=done.history,
        validations=list(done.history[-1].validation_J),
        cost=cost_chart("cost", done.history),
        known=coverage_chart("known", done.history),
        regions=done.history[-1].regions,
        maps=_maps(evaluations, done.model),
        experiments=[
            _experiment(k, one, commands, iterations.plan.limits)
            for k, (one, commands) in enumerate(
                zip((h for h in done.history if h.number > 0), experiments, strict=True)
            )
            if commands is not None
        ],
        limits=iterations.plan.limits,
    )
    write_atomically(path, replace_unencodable(page))


def _title(path: Path, plan: Plan, count: int) -> str:
    experiments = "1 experiment" if count == 1 else f"{count} experiments"
    return f"Iteration {path.absolute().parent.name}: {experiments} on the {plan.rig.get('kind', '')} rig"


def headline(history: Sequence[Iteration]) -> str:
    """Return the page's first sentence."""
    newest = history[-1]
    count = sum(one.number > 0 for one in history)
    fresh = [one for one in history if one.fresh_J is not None]
    text = f"{count} experiments, {newest.total_s:.0f} s recorded: J = {newest.fit_J:.2f} % on all recordings together"
    if fresh:
        text += f"; the model before read J = {fresh[-1].fresh_J:.2f} % on the newest recording, which it had not seen"
    return f"{text}. {100 * newest.coverage:.0f} % of the states within the limits are covered."


def facts(plan: Plan, model: Model) -> dict[str, str]:
    """Return the facts under the title."""
    stop = plan.stop
    target = f", target {stop.target_J:g} %" if stop.target_J else ""
    return {
        "Experiments": f"{plan.experiments.kind}, {plan.experiments.duration_s:g} s each",
        "Stops at": f"{stop.budget_s:g} s recorded{target}",
        "Model": f"{model.structure.replace('_', ' ')}, {model.size}",
        "Rig": str(plan.rig.get("kind", "")),
        "Seed": str(plan.seed),
    }


def _experiment(number: int, one: Iteration, commands: RigCommands, limits: RigLimits) -> dict[str, Any]:
    speed, acceleration = commands.motion()
    return {
        "name": one.name,
        "figure": commands_figure(f"commands{number}", commands),
        "peaks": {
            "stroke": f"{1e3 * abs(commands.stroke_m - limits.centre_m).max():.1f} of {1e3 * limits.stroke_m:g} mm",
            "speed": f"{abs(speed).max():.2f} of {limits.speed_m_s:.3g} m/s",
            "acceleration": f"{abs(acceleration).max():.0f} of {limits.acceleration_m_s2:.3g} m/s²",
            "current": f"{commands.current_A.min():.2f} to {commands.current_A.max():.2f} A",
            "rest before": f"{one.rest_s:.0f} s",
            "heat load after": f"{one.load_W:.0f} W",
        },
    }


def _maps(evaluations: Sequence[Evaluation], model: Model) -> dict[str, Any]:
    grid = make_grid(evaluations, model.envelope)
    return {
        "coverage": coverage_map("coverage", grid, evaluations, [], model),
        "error": error_map("errors", grid, evaluations, [], model),
    }
