"""`ces identify --campaign`: a description of many identifications in, a folder of results out; a cut run resumes."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path

from ces_cli.campaign.progress import CampaignProgress
from ces_cli.campaign.tables import Summary, summary_tables, write_csv, write_markdown
from ces_cli.terminal import terminal
from ces_identify.campaign.cell import DONE, Outcome
from ces_identify.campaign.description import load_campaign
from ces_identify.campaign.plan import Campaign, Job, jobs
from ces_identify.campaign.results import Results, open_results
from ces_identify.campaign.workers import Recordings, on_cluster, on_this_machine
from ces_identify.recordings.signals_file import load_signals
from ces_observer.errors import CesError

FORCE = ("position", "current", "force")
OWN = frozenset({"campaign", "dask", "jobs", "out"})
MOST_SHOWN = 40  # rows in the terminal

Crew = Callable[[Sequence[Job], Recordings], Generator[Outcome, None, None]]


def add_campaign(to: argparse.ArgumentParser) -> None:
    """Add the options --campaign, --jobs and --dask."""
    to.add_argument(
        "--campaign",
        type=Path,
        metavar="FILE.yaml",
        help="identify every combination that FILE.yaml describes and compare them; --out is then a folder, and the "
        "same command goes on where a run was stopped",
    )
    to.add_argument(
        "--jobs", type=terminal.whole(1, 256), metavar="N", help="campaign: processes (default: all processors)"
    )
    to.add_argument("--dask", metavar="ADDRESS", help="campaign: compute on this Dask scheduler's workers (host:port)")


def run_campaign(options: argparse.Namespace, parser: argparse.ArgumentParser) -> int:
    """Run what --campaign describes; returns the exit status."""
    _require_own_options(options, parser)
    campaign = load_campaign(options.campaign)
    signals = load_signals(campaign.signals)
    recordings = {path: terminal.read_one(path, signals, FORCE) for path in campaign.paths}
    todo = jobs(campaign, recordings, repr(sorted(signals.by_name.items())))
    with open_results(options.out) as results:
        finished = _compute(todo, results, recordings, _crew(options))
        summary = Summary.of(campaign, todo, results.rows)
        _tell(summary, options.out)
    return _status(campaign, summary, finished)


def _require_own_options(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """Raise CesError if an option was given that a campaign has in its file instead, or no folder to write to."""
    if options.campaign is None:
        raise CesError("--jobs and --dask are of campaigns; give --campaign FILE.yaml, too (threads: --threads)")
    for action in parser._actions:  # argparse has no public list
        value = getattr(options, action.dest, action.default)
        if action.dest not in OWN and value not in (action.default, []):
            given = action.option_strings[-1] if action.option_strings else action.metavar
            raise CesError(f"{given} has no effect with --campaign; say it in {options.campaign} instead")
    if options.out == parser.get_default("out"):
        raise CesError("--campaign needs a folder for its results; give --out DIR")
    if options.dask is not None and options.jobs is not None:
        raise CesError("--jobs is about this machine; with --dask the cluster's workers are what there is")


def _crew(options: argparse.Namespace) -> Crew:
    if options.dask is not None:
        return partial(on_cluster, address=options.dask)
    return partial(on_this_machine, processes=options.jobs or os.cpu_count() or 1)


def _compute(todo: Sequence[Job], results: Results, recordings: Recordings, crew: Crew) -> bool:
    """Compute the cells that are not there yet; returns False if Ctrl-C ended it before the last."""
    missing = [job for job in todo if not results.has(job.key)]
    if not missing:
        return True
    progress = CampaignProgress(len(todo), len(todo) - len(missing))
    try:
        with progress, closing(crew(missing, recordings)) as outcomes:
            for outcome in outcomes:
                results.add(outcome)
                progress.listen(outcome.row)
    except KeyboardInterrupt:
        results.refresh()
        return False
    return True


def _tell(summary: Summary, folder: Path) -> None:
    """Write the tables and the plot, and print the table."""
    if not any(row["status"] == DONE for row in summary.rows):
        return
    from ces_cli.campaign.picture import save_pareto_picture

    write_csv(summary, folder / "results.csv")
    write_markdown(summary, folder / "results.md")
    for suffix in ("svg", "png"):
        save_pareto_picture(summary, folder / f"pareto.{suffix}")
    terminal.out.print(*summary_tables(summary, MOST_SHOWN))
    for line in summary.lines():
        terminal.out.print(line, highlight=False, soft_wrap=True)
    print(f"results: {folder}/results.md, results.csv, pareto.svg, pareto.png, models/")


def _status(campaign: Campaign, summary: Summary, finished: bool) -> int:
    failed = [row for row in summary.rows if row["status"] != DONE]
    if not finished:
        terminal.note(
            f"interrupted with {len(summary.rows)} of {summary.planned} cells; the same command goes on from there"
        )
        return terminal.INTERRUPTED
    for row in failed:
        terminal.note(f"{summary.describe(row)}: {row['reason']}")
    if len(failed) == len(summary.rows):
        raise CesError(f"{campaign.source}: none of the {len(failed)} cells gave a model, for the reasons above")
    return 0
