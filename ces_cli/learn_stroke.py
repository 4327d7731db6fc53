"""`ces learn-stroke`: learns the command that makes the rig's piston follow a wanted stroke."""

from __future__ import annotations

import shlex
import shutil
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from itertools import count
from pathlib import Path

from ces_cli.terminal import terminal
from ces_cli.terminal.options import JSON, RIG_SEED, Argument
from ces_cli.terminal.outputs import make_schemas, print_document, require_folder
from ces_iterate.stroke import page
from ces_iterate.stroke.learning import LearningRun, learn_stroke, require_learnable
from ces_iterate.stroke.plan import load_plan
from ces_observer.errors import CesError
from ces_observer.options import Option


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = make_parser().parse_args(argv)
    runs: Path = options.out / "runs"
    for folder in (options.out, runs):
        require_folder(folder)
    if (options.out / page.RESULT).exists() and not options.overwrite:
        raise CesError(f"{options.out / page.RESULT}: exists; choose another --out, or replace it with --overwrite")
    plan = load_plan(options.plan, options.seed)
    require_learnable(plan.goal)
    rig = plan.open_rig(runs)
    runs.mkdir(parents=True, exist_ok=True)
    for path in runs.glob("run_[0-9][0-9]*") if options.overwrite else ():
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    numbers = count(1)

    def on_run(run: LearningRun) -> None:
        text = f"run {next(numbers):2d}: {1e6 * run.error_m:7.1f} µm RMS  {page.describe_kind(run)}"
        print(text, flush=True, file=sys.stderr if options.json else sys.stdout)

    with terminal.err.status(f"learning {plan.experiment.settings.name}"):
        learned = learn_stroke(rig, plan.goal, on_run)
    command = " ".join(["ces learn-stroke", *map(shlex.quote, argv or sys.argv[1:])])
    make_schemas()  # the learned experiment names its schema
    facts = {"Plan": str(options.plan), "Date": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC", "Command": command}
    page.write_results(options.out, plan, learned, facts)
    for text in page.find_warnings(learned):
        terminal.print_warning(text)
    files = (page.COMMAND, page.EXPERIMENT, page.RESULT, page.REPORT)
    if options.json:
        print_document("learn-stroke", {**page.as_json(learned), "files": [options.out / name for name in files]})
    else:
        print(f"{page.summary_sentence(learned)} Stopped: {learned.stopped}.")
        print(f"results: {options.out}/{', '.join(files)}")
    return 0


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    plan = "plan (YAML): experiment, actuator, limits (docs/learn-stroke.md)"
    return terminal.parser(
        "learn-stroke",
        "Learn, run by run, the command that makes the rig's piston follow a wanted stroke in spite of its actuator "
        "(iterative learning control). Run again with the same plan and folder, it reads the logs of a dyno again.",
        "ces learn-stroke plan.yaml --out learned",
        Argument("plan", meaning=plan, kind=Path, metavar="PLAN"),
        Option("out", meaning="folder for runs and results", kind=Path, metavar="DIR"),
        RIG_SEED,
        Option("overwrite", False, "delete the runs in DIR and start anew"),
        JSON,
    )
