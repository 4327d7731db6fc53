"""The page of an iteration: tables and figures of what is done so far go into the template."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ces_identify.report.grid import make_grid
from ces_identify.report.maps import coverage_map, error_map
from ces_identify.report.shell import page_template, replace_unencodable
from ces_identify.validation.evaluate import Evaluation
from ces_iterate.commands import RigCommands
from ces_iterate.loop.identification import evaluate_fresh
from ces_iterate.loop.iterate import Iterations
from ces_iterate.loop.store import Iteration, Step
from ces_iterate.plan.limits import RigLimits
from ces_iterate.plan.plan import Plan
from ces_iterate.report.figures import commands_figure, cost_chart, coverage_chart
from ces_observer.json_checks import write_atomically
from ces_observer.model import Model


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
