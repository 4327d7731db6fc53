"""`ces diagnose --each`: diagnoses every recording or vehicle; an interrupted run can be continued."""

from __future__ import annotations

import argparse
import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePath

from ces_cli.diagnose.fleet_page import write_page
from ces_cli.diagnose.fleet_tables import describe_diagnosis, explain_dashes, fleet_table, sort_rows, write_csv
from ces_cli.diagnose.inputs import build_diagnose_options, read_with_predictions, require_one_source, take_simulation
from ces_cli.terminal import terminal
from ces_cli.terminal.bag_paths import FleetUnit, find_bags, find_fleet_units
from ces_cli.terminal.json_output import print_document, without_text
from ces_cli.terminal.many_jobs import report_failures, run_jobs
from ces_cli.terminal.outputs import require_folder
from ces_cli.terminal.progress import DiagnoseProgress, JobsProgress
from ces_cli.terminal.simulations import open_simulation, with_predictions
from ces_gap.fleet.request import DiagnosisJob, DiagnosisRequest, job_of
from ces_gap.fleet.unit_result import diagnose_unit
from ces_gap.intake.checks import is_seen
from ces_gap.pipeline import DiagnoseOptions, diagnose
from ces_gap.report.result_files import result_files
from ces_identify.jobs.job import DONE, FAILED
from ces_identify.jobs.results_folder import ResultsFolder, open_results
from ces_identify.jobs.row_log import Row
from ces_identify.jobs.workers import Task
from ces_identify.recordings.bag_reader import read_recording
from ces_identify.recordings.checks import require_usable
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import Simulation
from ces_observer.errors import CesError
from ces_observer.signals import Signals

RESULTS = "fleet.jsonl"
MAX_NAMES = 6  # of vehicles or recordings in a line
REQUEST = "request"  # key of the object that all tasks share


def run_fleet(options: argparse.Namespace) -> int:
    """Diagnose every unit of --real; returns the exit status."""
    require_one_source(options)
    require_folder(options.out)
    signals = terminal.load_described_signals(options)
    units = find_fleet_units(options.real, options.each)
    given = None if options.identify else open_simulation(options.sim)
    reference = tuple(read_with_predictions(given, path, signals) for path in find_bags(options.reference))
    how = build_diagnose_options(options, threads=1)
    with open_results(options.out / RESULTS, "a fleet") as results:
        request = _build_request(given, reference, how, options)
        jobs, unread = _plan_jobs(units, request, signals, options.out)
        missing = {job: unit for job, unit in jobs.items() if not results.has(job)}
        finished = _compute(results, missing, request, signals, options, len(units))
        rows = [results.rows[job.key] for job in jobs if job.key in results.rows] + unread
        with without_text(options.json):
            _write_and_print(rows, options.out, PurePath(request.spec).name)
    if options.json:
        print_document("fleet", {"folder": options.out, "planned": len(units), "diagnoses": sort_rows(rows)})
    return report_failures(rows, len(units), finished, "diagnoses", lambda row: str(row["name"]))


def _build_request(
    given: Simulation | None, reference: tuple[Recording, ...], how: DiagnoseOptions, options: argparse.Namespace
) -> DiagnosisRequest:
    with DiagnoseProgress() as progress:
        simulation, spec = take_simulation(given, reference, options, os.cpu_count() or 1, progress.listen)
    return DiagnosisRequest(simulation, spec, reference, how, diagnose, result_files)


def _plan_jobs(
    units: Sequence[FleetUnit], request: DiagnosisRequest, signals: Signals, folder: Path
) -> tuple[dict[DiagnosisJob, FleetUnit], list[Row]]:
    """Return a job for each unit that can be read, and a row for each that cannot; keeps no recordings in memory."""
    described = repr(sorted(signals.by_name.items()))
    jobs: dict[str, tuple[DiagnosisJob, FleetUnit]] = {}
    unread, seen = [], []
    for number, unit in enumerate(units, start=1):
        with terminal.err.status(f"reading {unit.name} ({number} of {len(units)})"):
            try:
                recordings = _read(request.simulation, unit, signals)
                seen += [unit.name] if any(is_seen(one, request.simulation) for one in recordings) else []
                job = job_of(unit.name, recordings, request, described, folder)
                if job.key in jobs:
                    raise CesError(f"the same recordings as {jobs[job.key][0].name}")
                jobs[job.key] = (job, unit)
            except CesError as error:
                unread.append({"key": "", "name": unit.name, "status": FAILED, "reason": str(error)})
    _warn_of_seen(seen, PurePath(request.spec).name)
    return dict(jobs.values()), unread


def _warn_of_seen(units: Sequence[str], simulation: str) -> None:
    if units:
        more = f" and {len(units) - MAX_NAMES} more" if len(units) > MAX_NAMES else ""
        terminal.print_warning(
            f"{', '.join(units[:MAX_NAMES])}{more}: {simulation} was identified on seconds of their recordings: their "
            "gaps are smaller than on new recordings, and effects may be missing"
        )


def _read(simulation: Simulation, unit: FleetUnit, signals: Signals) -> list[Recording]:
    """Read and check the recordings of a unit without printing warnings."""
    recordings = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for path in unit.paths:
            recording = with_predictions(simulation, path, read_recording(path, signals, terminal.FORCE), signals)
            require_usable(recording)
            recordings.append(recording)
    return recordings


def _compute(
    results: ResultsFolder,
    missing: Mapping[DiagnosisJob, FleetUnit],
    request: DiagnosisRequest,
    signals: Signals,
    options: argparse.Namespace,
    total: int,
) -> bool:
    """Run the diagnoses that have no result yet; returns False if Ctrl-C came before the last."""
    if not missing:
        return True
    tasks = (Task(job, [REQUEST], _read(request.simulation, unit, signals)) for job, unit in missing.items())
    shared = {REQUEST: request.pack()}
    progress = JobsProgress(total, total - len(missing), "diagnoses")
    threads = request.options.threads
    return run_jobs(diagnose_unit, tasks, shared, threads, options, results, progress, describe_diagnosis)


def _write_and_print(rows: Sequence[Row], folder: Path, simulation: str) -> None:
    """Write the tables and print the terminal's."""
    write_csv(rows, folder / "fleet.csv")
    write_page(rows, folder / "fleet.html", simulation)
    if any(row["status"] == DONE for row in rows):
        terminal.print_table(fleet_table(rows))
        if dashes := explain_dashes(rows):
            print(dashes)
    print(f"written: {folder}/fleet.html, fleet.csv, fleet.jsonl, units/")
