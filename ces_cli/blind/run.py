"""`ces blind run`: diagnoses every case from its recordings alone; an interrupted run can be continued.

It never opens the seal: a folder with a copy of `cases/` is enough.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ces_cli.blind.case import ROW, Mode, diagnose_case
from ces_cli.terminal import terminal
from ces_cli.terminal.progress import JobsProgress
from ces_identify.jobs.workers import run_in_processes
from ces_observer.errors import CesError
from ces_observer.json_checks import write_atomically

SETTINGS = "run.json"


def run(options: argparse.Namespace) -> int:
    """Diagnose the cases without a finished diagnosis, failed ones again; returns the exit status. Raises CesError."""
    mode = Mode(options.predictions, not options.no_reference)
    cases = _find_cases(options.cases, options.limit)
    _require_same_settings(options.out, {**asdict(mode), "seal": read_seal(options.cases)})
    failed = _diagnose(cases, options.out, mode, options.jobs)
    print(f"{options.out}: {len(cases) - len(failed)} of {len(cases)} cases diagnosed")
    for case, reason in failed:
        terminal.print_warning(f"case {case}: {reason}")
    if failed and len(failed) == len(cases):
        raise CesError(f"{options.cases}: none of the cases could be diagnosed, for the reasons above")
    return 0


def _diagnose(cases: Sequence[Path], results: Path, mode: Mode, processes: int) -> list[tuple[str, str]]:
    """Diagnose the cases without a result and return those that failed, with the reason."""
    failed = []
    missing = [case for case in cases if not _is_done(results / case.name / ROW)]
    with JobsProgress(len(cases), len(cases) - len(missing), "cases") as progress:
        tasks = [(case, results / case.name, mode) for case in missing]
        for row in run_in_processes(diagnose_case, tasks, processes, threads=1):
            progress.count(_describe_row(row), failed=row["status"] != "done")
            if row["status"] != "done":
                failed.append((row["case"], row["reason"]))
    return sorted(failed)


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
    """Write the run's settings beside the results; raises CesError if results with other settings exist."""
    path = results / SETTINGS
    if path.is_file() and json.loads(path.read_text(encoding="utf-8")) != settings:
        raise CesError(f"{results}: holds results of other cases or options; choose another folder for --out")
    results.mkdir(parents=True, exist_ok=True)
    write_atomically(path, json.dumps(settings) + "\n")


def _is_done(row: Path) -> bool:
    return row.is_file() and json.loads(row.read_text(encoding="utf-8"))["status"] == "done"


def _describe_row(row: dict[str, Any]) -> str:
    text = row["summary"] if row["status"] == "done" else row["reason"]
    return f"case {row['case']}: {text}, {row['seconds']:.1f} s"
