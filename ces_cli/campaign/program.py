"""`ces identify --campaign`: runs the identifications that a file describes; an interrupted run can be continued."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from ces_cli.campaign.live_page import LivePage, write_recommended_reports
from ces_cli.campaign.tables import Summary, summary_facts, summary_tables, write_csv, write_markdown
from ces_cli.terminal import terminal
from ces_cli.terminal.bag_paths import with_distinct_names
from ces_cli.terminal.json_output import print_document, without_text
from ces_cli.terminal.many_jobs import ONE_PLACE, add_jobs, report_failures, run_jobs
from ces_cli.terminal.option_rules import ALL, never_with, only_with
from ces_cli.terminal.outputs import require_folder
from ces_cli.terminal.progress import JobsProgress
from ces_identify.campaign.cell import compute_cell
from ces_identify.campaign.description import load_campaign
from ces_identify.campaign.plan import CampaignJob, jobs
from ces_identify.jobs.job import DONE
from ces_identify.jobs.results_folder import ResultsFolder, open_results
from ces_identify.jobs.row_log import Row
from ces_identify.jobs.workers import Task
from ces_identify.recordings.recording import Recording
from ces_identify.recordings.signals_file import load_signals
from ces_identify.sense.sense import require_sensible, sense_each
from ces_observer.errors import CesError

MAX_ROWS_SHOWN = 40  # rows in the terminal
RESULTS = "results.jsonl"


def add_campaign(to: argparse.ArgumentParser) -> None:
    """Add the options --campaign, --jobs and --dask."""
    text = (
        "identify every combination that FILE.yaml describes and compare them; --out is then a folder, and the same "
        "command continues an interrupted run"
    )
    to.add_argument("--campaign", type=Path, metavar="FILE.yaml", help=text)
    add_jobs(to, "campaign")


CAMPAIGN_RULES = (
    only_with("jobs dask", "campaign", "applies to campaigns; add --campaign FILE.yaml (for threads use --threads)"),
    never_with(
        ALL,
        "campaign",
        "has no effect with --campaign; set it in {campaign} instead",
        but="campaign dask jobs out json force",
    ),
    ONE_PLACE,
)


def run_campaign(options: argparse.Namespace, parser: argparse.ArgumentParser) -> int:
    """Run the campaign that --campaign describes; returns the exit status."""
    if options.out == parser.get_default("out"):
        raise CesError("--campaign needs a folder for its results; add --out DIR")
    require_folder(options.out)
    campaign = load_campaign(options.campaign)
    signals = load_signals(campaign.signals)
    recordings = with_distinct_names(
        {path: terminal.read_one(path, signals, terminal.FORCE) for path in campaign.paths}
    )
    found = sense_each(list(recordings.values()))
    forced = require_sensible(found, options.force)
    for finding in found:
        terminal.print_warning(finding.text)
    todo = jobs(campaign, recordings, repr(sorted(signals.by_name.items())), forced)
    with open_results(options.out / RESULTS, "a campaign") as results:
        page = LivePage(options.out, campaign, todo, results)
        describe = partial(_describe_cell, Summary.from_rows(campaign, todo, {}))
        finished = _compute(todo, results, recordings, options, describe, page.refresh)
        summary = Summary.from_rows(campaign, todo, results.rows)
        write_recommended_reports(page.rows(), options.out, recordings, todo)
        page.write(running=False)
        with without_text(options.json):
            _write_and_print(summary, options.out)
    if options.json:
        print_document("campaign", summary_facts(summary, options.out))
    return report_failures(summary.rows, summary.planned, finished, "cells", summary.names.full_name)


def _compute(
    todo: Sequence[CampaignJob],
    results: ResultsFolder,
    recordings: Mapping[Path, Recording],
    options: argparse.Namespace,
    describe: Callable[[Row], str],
    after_each: Callable[[], None],
) -> bool:
    """Compute the cells that have no result yet; returns False if Ctrl-C came before the last."""
    missing = [job for job in todo if not results.has(job)]
    if not missing:
        return True
    tasks = [Task(job, job.paths) for job in missing]
    threads = max(job.limits.threads for job in missing)
    progress = JobsProgress(len(todo), len(todo) - len(missing), "cells")
    return run_jobs(compute_cell, tasks, recordings, threads, options, results, progress, describe, after_each)


def _describe_cell(summary: Summary, row: Row) -> str:
    name = summary.names.full_name(row)
    if row["status"] != DONE:
        return f"{name}: {row['status']}: {row['reason']}"
    cost = "diverged" if row["selection_J"] is None else f"{row['selection_J']:.2f} %"
    return f"{name}: selection J {cost}, {row['parameters']} parameters, {row['seconds']:.1f} s"


def _write_and_print(summary: Summary, folder: Path) -> None:
    """Write the tables and the plot, and print the table."""
    if not any(row["status"] == DONE for row in summary.rows):
        return
    from ces_cli.campaign.picture import save_pareto_picture

    write_csv(summary, folder / "results.csv")
    write_markdown(summary, folder / "results.md")
    for suffix in ("svg", "png"):
        save_pareto_picture(summary, folder / f"pareto.{suffix}")
    for table in summary_tables(summary, MAX_ROWS_SHOWN):
        terminal.print_table(table)
    for line in summary.lines():
        terminal.out.print(line, highlight=False, soft_wrap=True)
    print(f"results: {folder}/campaign.html, results.md, results.csv, pareto.svg, pareto.png, models/, reports/")
