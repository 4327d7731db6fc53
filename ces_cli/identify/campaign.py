"""`ces identify --campaign`: many identifications, with a live page, tables, a picture and the recommended reports."""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from ces_cli.identify.campaign_results import (
    BEST,
    Summary,
    save_pareto_picture,
    summary_facts,
    summary_tables,
    write_csv,
    write_markdown,
)
from ces_cli.terminal import terminal
from ces_cli.terminal.options import ALL, never_with, only_with
from ces_cli.terminal.outputs import print_document, require_folder, without_text
from ces_cli.terminal.progress import ONE_PLACE, JobsProgress, report_failures, run_jobs
from ces_cli.terminal.recordings import print_warnings, with_distinct_names
from ces_data.checks.check import check_each, require_sound
from ces_data.recording import Recording
from ces_data.signals_file import load_signals
from ces_identify.campaign.campaign_page import PAGE, write_campaign_page
from ces_identify.campaign.campaign_rows import CampaignRows
from ces_identify.campaign.cell import compute_cell
from ces_identify.campaign.description import load_campaign
from ces_identify.campaign.plan import Campaign, CampaignJob, jobs
from ces_identify.jobs.results import DONE, ResultsFolder, Row, open_results
from ces_identify.jobs.workers import Task
from ces_identify.prepare.series import prepare
from ces_identify.report.page import write_report
from ces_identify.validation.evaluate import IDENTIFICATION, VALIDATION, evaluate
from ces_observer.errors import CesError
from ces_observer.model import load_model

REFRESH_S = 5.0  # between two versions of the page
REPORTS = "reports"
MAX_ROWS_SHOWN = 40  # rows in the terminal
RESULTS = "results.jsonl"


CAMPAIGN_RULES = (
    only_with("jobs dask", "campaign", "applies to campaigns; add --campaign FILE.yaml (for threads use --threads)"),
    never_with(
        ALL,
        "campaign",
        "has no effect with --campaign; set it in {campaign} instead",
        but="campaign dask jobs out json ignore_findings",
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
    found = check_each(list(recordings.values()))
    forced = require_sound(found, options.ignore_findings)
    print_warnings(found)
    todo = jobs(campaign, recordings, repr(sorted(signals.by_name.items())), forced)
    with open_results(options.out / RESULTS, "a campaign") as results:
        page = LivePage(options.out, campaign, todo, results)
        describe = partial(_describe_cell, Summary.from_rows(campaign, todo, {}))
        missing = [job for job in todo if not results.has(job)]
        finished = True
        if missing:
            tasks = [Task(job, job.paths) for job in missing]
            threads = max(job.limits.threads for job in missing)
            progress = JobsProgress(len(todo), len(todo) - len(missing), "cells")
            finished = run_jobs(
                compute_cell, tasks, recordings, threads, options, results, progress, describe, page.refresh
            )
        summary = Summary.from_rows(campaign, todo, results.rows)
        write_recommended_reports(page.rows(), options.out, recordings, todo)
        page.write(running=False)
        with without_text(options.json):
            _write_and_print(summary, options.out)
    if options.json:
        print_document("campaign", summary_facts(summary, options.out))
    return report_failures(summary.rows, summary.planned, finished, "cells", summary.names.full_name)


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
    write_csv(summary, folder / "results.csv")
    write_markdown(summary, folder / "results.md")
    for suffix in ("svg", "png"):
        save_pareto_picture(summary, folder / f"pareto.{suffix}")
    marks = summary.marks()
    for table in summary_tables(summary, MAX_ROWS_SHOWN):
        terminal.print_table(terminal.lay_out(table, lambda row: "bold" * (marks.get(row["key"]) == BEST)))
    for line in summary.lines():
        terminal.print_line(line)
    print(f"results: {folder}/campaign.html, results.md, results.csv, pareto.svg, pareto.png, models/, reports/")


class LivePage:
    """Writes the page into `folder` while results come in, at most every REFRESH_S."""

    def __init__(self, folder: Path, campaign: Campaign, todo: Sequence[CampaignJob], results: ResultsFolder) -> None:
        self._folder, self._campaign, self._todo, self._results = folder, campaign, todo, results
        self._written = -REFRESH_S

    def rows(self) -> CampaignRows:
        """Return the results of the planned cells so far."""
        found = self._results.rows
        rows = [{**found[j.key], "bags": j.cell.bags, **j.cell.settings} for j in self._todo if j.key in found]
        return CampaignRows(tuple(rows), len(self._todo), self._campaign.names)

    def refresh(self) -> None:
        """Write the page if the last version is old enough."""
        if time.monotonic() - self._written >= REFRESH_S:
            self.write(running=True)

    def write(self, *, running: bool) -> None:
        """Write the page, if there is any result."""
        rows = self.rows()
        if rows.rows:
            facts = {"command": shlex.join(["ces", *sys.argv[1:]])}
            write_campaign_page(
                self._folder / PAGE, rows, self._folder, self._campaign.source.stem, facts, running=running
            )
        self._written = time.monotonic()


def write_recommended_reports(
    results: CampaignRows, folder: Path, recordings: Mapping[Path, Recording], todo: Sequence[CampaignJob]
) -> None:
    """Write the report of the recommended model of each set of bags, unless it is there."""
    jobs = {job.key: job for job in todo}
    for row in results.recommended().values():
        job, path = jobs[row["key"]], folder / REPORTS / f"{row['key']}.html"
        if path.exists():
            continue
        model = load_model(folder / job.output)
        fitted = [prepare(recordings[p], model.sampling).part(0.0, job.split) for p in job.recordings]
        held_out = [prepare(recordings[p], model.sampling) for _, p in job.validation]
        evaluations = evaluate(model, fitted, IDENTIFICATION) + evaluate(model, held_out, VALIDATION)
        path.parent.mkdir(exist_ok=True)
        write_report(path, f"{results.full_name(row)} of a campaign", model, evaluations, {})
