"""`ces iterate`: designs experiments inside a rig's limits, has them run, and identifies a model, until it is good."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from ces_cli.iterate.progress import IterateProgress
from ces_cli.terminal import terminal
from ces_cli.terminal.options import ALL, JSON, never_with
from ces_cli.terminal.outputs import print_document, require_folder, schema_line
from ces_identify.progress_file import SearchProgressFile
from ces_iterate.loop.iterate import Iterations
from ces_iterate.loop.store import MODEL, PLAN, REPORT, keep_plan
from ces_iterate.plan import TEMPLATE, Plan, load_plan
from ces_iterate.rigs.kinds import RigAdapter, open_rig


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    parser = make_parser()
    options = parser.parse_args(argv)
    if options.template:
        print(schema_line("iterate") + TEMPLATE, end="")
        return 0
    if options.plan is None:
        parser.error("expected PLAN (or --template)")
    _iterate(options)
    return 0


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    p = terminal.parser(
        "iterate",
        "Design an experiment inside a rig's limits, run it, score the model on it, identify anew, and so on, until a "
        "target or a budget is reached. Ctrl-C stops at any point; the same command goes on.",
        "ces iterate plan.yaml --out rear_damper",
    )
    p.add_argument("plan", nargs="?", type=Path, metavar="PLAN", help="the plan (YAML)")
    text = "folder of all experiments, recordings and models (default: the plan's name without .yaml)"
    p.add_argument("--out", type=Path, metavar="DIR", help=text)
    p.add_argument("--template", action="store_true", help="print a plan with every key explained and exit")
    terminal.add_options(p, JSON)
    p.rules = (never_with(ALL, "template", "does not apply with --template", but="template"),)
    return p


def _iterate(options: argparse.Namespace) -> None:
    plan = load_plan(options.plan)
    out = options.out if options.out is not None else options.plan.with_suffix("")
    require_folder(out)
    rig = open_rig(plan)
    shown = IterateProgress(plan.stop.budget_s, terminal.err if options.json else terminal.out)
    with shown as progress, ExitStack() as opened:
        iterations = _open_iterations(plan, rig, out, progress)
        progress.after_iteration = lambda: _write_results(iterations)

        def begin() -> None:
            keep_plan(out, plan, options.plan.read_text(encoding="utf-8"))
            progress.file = opened.enter_context(SearchProgressFile("iterate", out, {"budget_s": plan.stop.budget_s}))

        reason = iterations.run(begin)
    _write_results(iterations)
    if options.json:
        files = {"model": out / MODEL, "report": out / REPORT, "plan": out / PLAN}
        print_document("iterate", {"stopped": reason, "iterations": iterations.done.history, **files})
        return
    print(f"stopped: {reason}")
    print(f"model:  {out / MODEL}\nreport: {out / REPORT}\nplan:   {out / PLAN}")


def _open_iterations(plan: Plan, rig: RigAdapter, out: Path, progress: IterateProgress) -> Iterations:
    """Return the iteration; what is to be known about the plan's recordings is printed, one line each."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        iterations = Iterations(plan, rig, out, progress)
    for warning in caught:
        terminal.print_warning(str(warning.message))
    return iterations


def _write_results(iterations: Iterations) -> None:
    from ces_iterate.page import write_page

    if iterations.done.model is not None:
        iterations.done.model.save(iterations.out / MODEL)
        write_page(iterations.out / REPORT, iterations)
