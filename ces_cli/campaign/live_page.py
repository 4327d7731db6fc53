"""The page of a campaign while it runs and at its end, and the reports of its recommended models."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from ces_identify.campaign.campaign_page import PAGE, write_campaign_page
from ces_identify.campaign.campaign_rows import CampaignRows
from ces_identify.campaign.plan import Campaign, CampaignJob
from ces_identify.jobs.results_folder import ResultsFolder
from ces_identify.preparation.series import prepare
from ces_identify.recordings.recording import Recording
from ces_identify.report import write_report
from ces_identify.validation.evaluate import IDENTIFICATION, VALIDATION, evaluate
from ces_observer.model import load_model

REFRESH_S = 5.0  # between two versions of the page
REPORTS = "reports"


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
