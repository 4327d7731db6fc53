"""`ces blind run`: diagnoses every case from its recordings alone; an interrupted run can be continued.

Every mode has a folder of its own in the folder for results. The seal is never opened: a folder with a copy of `cases/`
is enough.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ces_cli.blind.case import ROW, diagnose_case
from ces_cli.blind.mode import Mode, combine_modes
from ces_cli.terminal import terminal
from ces_cli.terminal.json_output import print_document, without_text
from ces_cli.terminal.progress import JobsProgress
from ces_identify.jobs.workers import run_in_processes
from ces_observer.errors import CesError
from ces_observer.json_checks import write_atomically

SETTINGS = "run.json"


def run(options: argparse.Namespace) -> int:
    """Diagnose the cases without a finished diagnosis, failed ones again; returns the exit status. Raises CesError."""
    modes = combine_modes(options.simulation, options.references)
    cases, seal = _find_cases(options.cases, options.limit), read_seal(options.cases)
    for mode in modes:
        _require_same_settings(options.out / mode.name, {**asdict(mode), "seal": seal})
    failed = _diagnose(cases, options.out, modes, options.jobs)
    count = len(cases) * len(modes)
    with without_text(options.json):
        print(f"{options.out}: {count - len(failed)} of {count} diagnoses done ({', '.join(m.name for m in modes)})")
    for where, reason in failed:
        terminal.print_warning(f"{where}: {reason}")
    if len(failed) == count:
        raise CesError(f"{options.cases}: none of the cases could be diagnosed, for the reasons above")
    if options.json:
        print_document("blind-run", _as_json(options.out, modes, count, failed))
    return 0


def _as_json(out: Path, modes: Sequence[Mode], count: int, failed: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """Return the document of --json."""
    failures = [{"case": where, "reason": reason} for where, reason in failed]
    return {"folder": out, "modes": [mode.name for mode in modes], "diagnoses": count, "failed": failures}


def _diagnose(cases: Sequence[Path], results: Path, modes: Sequence[Mode], processes: int) -> list[tuple[str, str]]:
    """Diagnose the cases without a result, and return the modes and cases that failed, with the reason."""
    failed = []
    planned = [(case, results / mode.name / case.name, mode) for mode in modes for case in cases]
    missing = [task for task in planned if not _is_done(task[1] / ROW)]
    with JobsProgress(len(planned), len(planned) - len(missing), "diagnoses") as progress:
        for row in run_in_processes(_run_task, missing, processes, threads=1):
            progress.count(_describe_row(row), failed=row["status"] != "done")
            if row["status"] != "done":
                failed.append((f"{row['mode']}, case {row['case']}", row["reason"]))
    return sorted(failed)


def _run_task(case: Path, out: Path, mode: Mode) -> dict[str, Any]:
    return {**diagnose_case(case, out, mode), "mode": mode.name}


def _find_cases(folder: Path, limit: int | None) -> list[Path]:
    cases = sorted(path.parent for path in folder.glob("cases/*/case.json"))
    if not cases:
        raise CesError(f"{folder}: contains no cases/NNNN/case.json; expected the output of 'ces blind make'")
    return cases[:limit]


def read_seal(folder: Path) -> str:
    """Return the published hash that shows which results and cases belong together."""
    path = folder / "cases" / "seal.sha256"
    return path.read_text(encoding="utf-8").strip() if path.is_file() else ""


def _require_same_settings(results: Path, settings: dict[str, Any]) -> None:
    """Write the run's settings beside the results; raises CesError if results of other cases exist."""
    path = results / SETTINGS
    if path.is_file() and json.loads(path.read_text(encoding="utf-8")) != settings:
        raise CesError(f"{results}: holds results of other cases; choose another folder for --out")
    results.mkdir(parents=True, exist_ok=True)
    write_atomically(path, json.dumps(settings) + "\n")


def _is_done(row: Path) -> bool:
    return row.is_file() and json.loads(row.read_text(encoding="utf-8"))["status"] == "done"


def _describe_row(row: dict[str, Any]) -> str:
    text = row["summary"] if row["status"] == "done" else row["reason"]
    return f"{row['mode']}, case {row['case']}: {text}, {row['seconds']:.1f} s"
