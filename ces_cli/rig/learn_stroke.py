"""`ces learn-stroke`: learns the command that makes the rig's piston follow a wanted stroke."""

from __future__ import annotations

import argparse
import shlex
import shutil
import sys
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TextIO

from ces_cli.terminal import terminal
from ces_cli.terminal.options import JSON, RIG_SEED
from ces_cli.terminal.outputs import make_schemas, print_document, require_folder
from ces_iterate.stroke.learning import LearningRun, learn_stroke, require_learnable
from ces_iterate.stroke.page import (
    COMMAND,
    EXPERIMENT,
    REPORT,
    RESULT,
    as_json,
    describe_kind,
    find_warnings,
    summary_sentence,
    write_results,
)
from ces_iterate.stroke.plan import load_plan
from ces_iterate.stroke.rigs import StoredRuns

RUNS = "runs"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = make_parser().parse_args(argv)
    require_folder(options.out)
    plan = load_plan(options.plan, options.seed)
    require_learnable(plan.goal)
    runs = options.out / RUNS
    rig = plan.open_rig(runs)
    _open_folder(options)
    with terminal.err.status(f"learning {plan.experiment.settings.name}"):
        learned = learn_stroke(
            StoredRuns(rig, runs, plan.identity), plan.goal, _print_runs(sys.stderr if options.json else sys.stdout)
        )
    facts = {"Plan": str(options.plan), "Date": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"}
    command = " ".join(["ces learn-stroke", *map(shlex.quote, argv or sys.argv[1:])])
    make_schemas()  # the learned experiment names its schema
    write_results(options.out, plan, learned, {**facts, "Command": command})
    for text in find_warnings(learned):
        terminal.print_warning(text)
    if options.json:
        files = [options.out / name for name in (COMMAND, EXPERIMENT, RESULT, REPORT)]
        print_document("learn-stroke", {**as_json(learned), "files": files})
        return 0
    print(f"{summary_sentence(learned)} Stopped: {learned.stopped}.")
    print(f"results: {options.out}/{COMMAND}, {EXPERIMENT}, {RESULT}, {REPORT}")
    return 0


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    p = terminal.parser(
        "learn-stroke",
        "Learn, run by run, the command that makes the rig's piston follow a wanted stroke in spite of its actuator "
        "(iterative learning control). Run again with the same plan and folder, it continues where it stopped.",
        "ces learn-stroke plan.yaml --out learned",
    )
    p.add_argument(
        "plan", type=Path, metavar="PLAN", help="plan (YAML): experiment, actuator, limits (docs/learn-stroke.md)"
    )
    p.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for runs and results")
    terminal.add_options(p, RIG_SEED)
    p.add_argument("--overwrite", action="store_true", help="delete the runs in DIR and start anew")
    terminal.add_options(p, JSON)
    return p


def _open_folder(options: argparse.Namespace) -> None:
    """Make the folder of the runs, empty with --overwrite."""
    runs: Path = options.out / RUNS
    require_folder(runs)
    runs.mkdir(parents=True, exist_ok=True)
    if options.overwrite:
        for path in runs.glob("run_[0-9][0-9]*"):
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def _print_runs(to: TextIO) -> Callable[[LearningRun], None]:
    """Return a function that prints a line for each run of the stroke."""
    count = 0

    def on_run(run: LearningRun) -> None:
        nonlocal count
        count += 1
        print(f"run {count:2d}: {1e6 * run.error_m:7.1f} µm RMS  {describe_kind(run)}", flush=True, file=to)

    return on_run
