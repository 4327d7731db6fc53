"""`ces iterate`: designs experiments inside a rig's limits, has them run, and identifies a model, until it is good."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.progress import TextColumn, TimeElapsedColumn

from ces_cli.terminal import terminal
from ces_cli.terminal.options import ALL, JSON, ProgramRequest, argument, never_with, option
from ces_cli.terminal.outputs import print_document, schema_line
from ces_cli.terminal.progress import LiveBar
from ces_data.outputs import require_folder
from ces_identify.numerics.search import SearchResult
from ces_observer.records import declare
from ces_rig.loop.iterate import IterateListener, Iterations
from ces_rig.loop.rigs import TEMPLATE, load_plan, open_rig
from ces_rig.loop.store import MODEL, PLAN, REPORT, Iteration, keep_plan


@dataclass(frozen=True, kw_only=True)
class IterateRequest(ProgramRequest):
    """Design an experiment inside a rig's limits, run it, score the model on it, identify anew, and so on, until a
    target or a budget is reached. Ctrl-C stops at any point; the same command goes on.
    """

    program = "iterate"
    example = "ces iterate plan.yaml --out rear_damper"
    option_rules = (never_with(ALL, "template", "does not apply with --template", but="template"),)

    plan: Path | None = argument(None, "the plan (YAML)", metavar="PLAN", count="?")
    out: Path | None = option(
        None, "folder of all experiments, recordings and models", none="the plan's name without .yaml", metavar="DIR"
    )
    template: bool = option(False, "print a plan with every key explained and exit")
    json: bool = declare(JSON)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    parser = terminal.parser(IterateRequest)
    request = parser.read(argv)
    if request.template:
        print(schema_line("iterate") + TEMPLATE, end="")
    elif request.plan is None:
        parser.error("expected PLAN (or --template)")
    else:
        _iterate(request.plan, request.out or request.plan.with_suffix(""), request.json)
    return 0


def _iterate(path: Path, out: Path, as_json: bool) -> None:
    plan = load_plan(path)
    require_folder(out)
    rig = open_rig(plan)
    lines_to = terminal.err if as_json else terminal.out
    with IterateProgress(plan.stop.budget_s, lines_to) as progress:
        with warnings.catch_warnings(record=True) as caught:  # what is to be known about the plan's recordings
            warnings.simplefilter("always")
            iterations = Iterations(plan, rig, out, progress)
        for warning in caught:
            terminal.print_warning(str(warning.message))
        progress.after_iteration = lambda: _write_results(iterations)
        reason = iterations.run(partial(keep_plan, out, plan, path.read_text(encoding="utf-8")))
    _write_results(iterations)
    files = {"model": out / MODEL, "report": out / REPORT, "plan": out / PLAN}
    if as_json:
        print_document("iterate", {"stopped": reason, "iterations": iterations.done.history, **files})
        return
    print(f"stopped: {reason}")
    for name, file in files.items():
        print(f"{name + ':':<7} {file}")


def _write_results(iterations: Iterations) -> None:
    from ces_rig.loop.page import write_page

    if iterations.done.model is not None:
        iterations.done.model.save(iterations.out / MODEL)
        write_page(iterations.out / REPORT, iterations)


class IterateProgress(LiveBar, IterateListener):
    """Shows an iteration; `listen_search` may be called from any thread."""

    estimates = False  # the budget is in seconds recorded

    def __init__(self, budget_s: float, lines_to: Console) -> None:
        columns = (TextColumn("{task.completed:.0f} of {task.total:.0f} s recorded"), TimeElapsedColumn())
        super().__init__("iterating", *columns, total=budget_s, text="(Ctrl-C stops; the same command goes on)")
        self.after_iteration: Callable[[], None] = lambda: None
        self._lines_to, self._recorded_s, self._step = lines_to, 0.0, ""

    def resume(self, history: Sequence[Iteration]) -> None:
        """Print what an earlier run has left."""
        newest = history[-1]
        self._lines_to.print(f"{len(history)} iterations, {newest.total_s:.1f} s recorded, are from an earlier run")

    def begin(self, number: int, step: str) -> None:
        """Show the step that begins."""
        self._step = f"iteration {number}: {step}"
        self.show(self._recorded_s, self._step)
        self.log(f"{self.elapsed_s:5.0f} s  {self._step}")

    def listen_search(self, news: SearchResult | str) -> None:
        """Show the newest cost of the search, or what is done beside it."""
        with self._lock:
            text = news if isinstance(news, str) else f"selection cost J = {news.cost:.2f} %"
            self.show(self._recorded_s, f"{self._step}: {text}")

    def finish(self, iteration: Iteration) -> None:
        """Print the result of an iteration."""
        self._recorded_s = iteration.total_s
        self.show(self._recorded_s, self._step)
        self._lines_to.print(format_iteration(iteration), highlight=False, soft_wrap=True)
        self.after_iteration()


def format_iteration(iteration: Iteration) -> str:
    """Return the line of an iteration."""
    fresh = "no model yet" if iteration.fresh_J is None else f"J {iteration.fresh_J:.2f} % on it before it was used"
    least = max(iteration.regions, key=lambda region: region.unknown)
    validation = "".join(f", {name} {cost:.2f} %" for name, cost in iteration.validation_J.items())
    return (
        f"{iteration.name}: {iteration.recorded_s:.1f} s recorded ({iteration.total_s:.1f} s in all); {fresh}, "
        f"{iteration.fit_J:.2f} % after the fit{validation}; {100 * iteration.coverage:.0f} % of the states covered; "
        f"least known: {least.axis} {least.low:.3g} to {least.high:.3g} {least.unit}"
    )
