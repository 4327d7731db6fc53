"""`ces diagnose`: finds the cause of the gap between a simulation and reality; `--each`: for many recordings."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path, PurePath

from ces_cli.diagnose import diagnosis
from ces_cli.terminal import terminal
from ces_cli.terminal.inputs import FleetUnit, find_fleet_units, open_simulation, with_predictions
from ces_cli.terminal.outputs import print_document
from ces_cli.terminal.progress import DiagnoseProgress, JobsProgress, report_failures, run_jobs
from ces_data.bags.find import find_bags
from ces_data.bags.reader import read_recording
from ces_data.findings import require_usable
from ces_data.outputs import OUT, require_folder, require_outputs
from ces_data.recording import Recording
from ces_data.signals_file import load_signals
from ces_gap.fleet import DiagnosisJob, DiagnosisRequest, diagnose_unit, job_of
from ces_gap.inputs.checks import is_seen
from ces_gap.pipeline import diagnose
from ces_gap.report.formatting import effect_name
from ces_gap.result_files import result_files
from ces_identify.jobs import DONE, FAILED, Row, Task, open_results
from ces_identify.simulations.simulation import Simulation
from ces_observer.errors import CesError
from ces_observer.json_text import write_atomically
from ces_observer.signals import Signals
from ces_report.table import Column, Table, as_csv


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    request = terminal.read(diagnosis.DiagnoseRequest, argv)
    if request.each is not None:
        return run_fleet(request, request.each)
    require_outputs(request.overwrite, folders={OUT: request.out})
    diagnosis.run_diagnosis(request, terminal.command_line("diagnose", argv))
    return 0


RESULTS = "fleet.jsonl"
MAX_NAMES = 6  # of vehicles or recordings in a line
REQUEST = "request"  # key of the object that all tasks share
MAX_ROWS_SHOWN = 60  # at the terminal
CSV_COLUMNS = (
    *("name", "status", "verdict", "effects", "cause", "probability", "gap_N", "gap_low_N", "gap_high_N"),
    *("noise_floor_N", "cost_J", "gap_after_N", "shrink", "shrink_low", "shrink_high", "sentence", "notes"),
    *("recordings", "folder", "seconds", "reason", "key"),
)


def run_fleet(request: diagnosis.DiagnoseRequest, each: str) -> int:
    """Diagnose every unit of --real; returns the exit status."""
    diagnosis.require_one_source(request)
    require_folder(request.out)
    signals = load_signals(request.signals)
    units = find_fleet_units(request.real, each)
    given = None if request.sim is None else open_simulation(request.sim)
    reference = tuple(
        diagnosis.read_with_predictions(given, path, signals, request.part) for path in find_bags(request.reference)
    )
    how = diagnosis.build_diagnose_options(request, threads=1)
    with open_results(request.out / RESULTS, "a fleet") as results:
        with DiagnoseProgress() as progress:
            simulation, spec = diagnosis.take_simulation(
                given, reference, request, os.cpu_count() or 1, progress.listen
            )
        common = DiagnosisRequest(simulation, spec, reference, how, diagnose, result_files)
        jobs, unread = _plan_jobs(units, common, signals, request)
        missing = {job: unit for job, unit in jobs.items() if not results.has(job)}
        if others := len(results.rows.keys() - {job.key for job in jobs}):
            things = f"{others} results of other recordings or options"
            terminal.print_warning(f"{request.out}: also holds {things}; they are neither shown nor used")
        bar, finished = JobsProgress(len(units), len(units) - len(missing), "diagnoses"), True
        if missing:
            tasks = (
                Task(job, [REQUEST], _read(simulation, unit, signals, request.part)) for job, unit in missing.items()
            )
            finished = run_jobs(
                diagnose_unit, tasks, {REQUEST: common}, how.threads, request.jobs, results, bar, describe_diagnosis
            )
        rows = [results.rows[job.key] for job in jobs if job.key in results.rows] + unread
        write_csv(rows, request.out / "fleet.csv")
    if request.json:
        print_document("fleet", {"folder": request.out, "planned": len(units), "diagnoses": sort_rows(rows)})
    else:
        _print_fleet(rows, request.out)
    return report_failures(rows, len(units), finished, "diagnoses", lambda row: str(row["name"]))


def _plan_jobs(
    units: Sequence[FleetUnit], request: DiagnosisRequest, signals: Signals, asked: diagnosis.DiagnoseRequest
) -> tuple[dict[DiagnosisJob, FleetUnit], list[Row]]:
    """Return a job for each unit that can be read, and a row for each that cannot; keeps no recordings in memory."""
    described = repr((sorted(signals.by_name.items()), *asked.part))
    jobs: dict[str, tuple[DiagnosisJob, FleetUnit]] = {}
    unread: list[Row] = []
    seen: list[str] = []
    for number, unit in enumerate(units, start=1):
        with terminal.step(f"reading {unit.name} ({number} of {len(units)})"):
            try:
                recordings = _read(request.simulation, unit, signals, asked.part)
                seen += [unit.name] if any(is_seen(recording, request.simulation) for recording in recordings) else []
                job = job_of(unit.name, recordings, request, described, asked.out)
                if job.key in jobs:
                    raise CesError(f"the same recordings as {jobs[job.key][0].name}")
                jobs[job.key] = (job, unit)
            except CesError as error:
                unread.append({"key": "", "name": unit.name, "status": FAILED, "reason": str(error)})
    if seen:
        more = f" and {len(seen) - MAX_NAMES} more" if len(seen) > MAX_NAMES else ""
        terminal.print_warning(
            f"{', '.join(seen[:MAX_NAMES])}{more}: {PurePath(request.spec).name} was identified on seconds of their "
            "recordings: their gaps are smaller than on new recordings, and effects may be missing"
        )
    return dict(jobs.values()), unread


def _read(simulation: Simulation, unit: FleetUnit, signals: Signals, part: Sequence[float]) -> list[Recording]:
    """Read and check the recordings of a unit without printing warnings."""
    recordings = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for path in unit.paths:
            whole = with_predictions(simulation, path, read_recording(path, signals, terminal.FORCE), signals)
            recording = whole.part(*part)
            require_usable(recording)
            recordings.append(recording)
    return recordings


def _print_fleet(rows: Sequence[Row], folder: Path) -> None:
    table = fleet_table(rows)
    done = [row for row in table.rows if row["status"] == DONE]
    if done:
        title = f"{len(done)} of {len(rows)} diagnosed" + "; the largest gaps" * (len(done) > MAX_ROWS_SHOWN)
        terminal.print_table(terminal.lay_out(replace(table, rows=done[:MAX_ROWS_SHOWN], title=title)))
    print(f"written: {folder}/fleet.csv, fleet.jsonl, units/")


def sort_rows(rows: Sequence[Row]) -> list[Row]:
    """Return the rows with the largest gap first, those without a diagnosis last."""
    return sorted(rows, key=lambda row: (row["status"] != DONE, -(row.get("gap_N") or 0.0), row["name"]))


def describe_diagnosis(row: Row) -> str:
    """Return the result of a diagnosis in a few words."""
    if row["status"] != DONE:
        return f"{row['name']}: {row['status']}: {row['reason']}"
    return f"{row['name']}: {describe_verdict(row)}, gap {_number('gap_N', '.1f')(row)} N, {row['seconds']:.1f} s"


def describe_verdict(row: Row) -> str:
    """Return the verdict with the effects that it names; the reason of a row without a diagnosis."""
    if row["status"] != DONE:
        return str(row["reason"])
    effects = " + ".join(map(effect_name, row["effects"]))
    verdict = str(row["verdict"]).replace("_", " ")
    return f"{verdict}: {effects}" if effects else verdict


def _number(key: str, form: str) -> Callable[[Row], str]:
    """Return the text of a number of a diagnosis: a dash if it is not known."""

    def text(row: Row) -> str:
        value = row.get(key)
        return "" if row["status"] != DONE else "-" if value is None else format(value, form)

    return text


def fleet_table(rows: Sequence[Row]) -> Table[Row]:
    """Return the table of a fleet, largest gap first, those without a diagnosis last."""

    def shrink(row: Row) -> str:
        if row["status"] != DONE:
            return ""
        return "-" if row["shrink"] is None or not row["effects"] else f"{100.0 * row['shrink']:.0f} %"

    columns: tuple[Column[Row], ...] = (
        Column("Vehicle or recording", lambda row: str(row["name"])),
        Column("Verdict", describe_verdict),
        Column("Probability", _number("probability", ".2f"), figure=True),
        Column("Gap [N RMS]", _number("gap_N", ".1f"), figure=True),
        Column("Left [N RMS]", _number("gap_after_N", ".1f"), figure=True),
        Column("Shrink", shrink, figure=True),
    )
    return Table(columns, sort_rows(rows))


def write_csv(rows: Sequence[Row], path: Path) -> None:
    """Write a line for each row, with lists joined by ` + `."""

    def cell(value: object) -> object:
        return " + ".join(map(str, value)) if isinstance(value, list) else value

    lines = [[cell(row.get(name)) for name in CSV_COLUMNS] for row in sort_rows(rows)]
    write_atomically(path, as_csv([CSV_COLUMNS, *lines]))
