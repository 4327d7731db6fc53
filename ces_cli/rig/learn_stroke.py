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
from ces_cli.terminal.json_output import add_json, print_document
from ces_iterate.stroke.errors import StrokeError
from ces_iterate.stroke.figures import describe_kind
from ces_iterate.stroke.goal import LearningRun
from ces_iterate.stroke.learning import learn_stroke, require_learnable
from ces_iterate.stroke.page import find_warnings, summary_sentence
from ces_iterate.stroke.plan import load_plan
from ces_iterate.stroke.result_files import COMMAND, EXPERIMENT, REPORT, RESULT, as_json, write_results
from ces_iterate.stroke.rig import StoredRuns

RUNS = "runs"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = make_parser().parse_args(argv)
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
    seed_type, text = (
        terminal.integer_between(0, 2**31),
        "random seed of the virtual rig (default: the experiment's own)",
    )
    p.add_argument("--seed", type=seed_type, metavar="N", help=text)
    p.add_argument("--overwrite", action="store_true", help="delete the runs in DIR and start anew")
    add_json(p)
    return p


def _open_folder(options: argparse.Namespace) -> None:
    """Make the folder of the runs, empty with --overwrite; raises StrokeError if --out is not a folder."""
    runs: Path = options.out / RUNS
    try:
        runs.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise StrokeError(f"{options.out}: is not a folder; choose another --out") from None
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
