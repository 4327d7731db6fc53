"""`ces blind run`: the diagnosis of every case from its recordings alone, in processes; a cut run resumes.

Nothing here opens the seal: a folder with a copy of `cases/` is enough.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ces_cli.blind.case import ROW, Mode, diagnose_case
from ces_cli.terminal import terminal
from ces_cli.terminal.progress import JobsProgress
from ces_identify.jobs.workers import run_in_processes
from ces_observer.errors import CesError
from ces_observer.json_checks import write_atomically

SETTINGS = "run.json"


@dataclass(frozen=True)
class CaseFolders:
    """Folders of cases and of their results."""

    cases: tuple[Path, ...]
    results: Path

    def find_missing(self) -> list[Path]:
        """Return the cases without a finished diagnosis; one that failed is tried again."""
        return [case for case in self.cases if not _is_done(self.results / case.name / ROW)]


def run(options: argparse.Namespace) -> int:
    """Diagnose the cases that are not there yet; returns the exit status. Raises CesError."""
    mode = Mode(options.predictions, not options.no_reference)
    todo = CaseFolders(_cases(options.cases, options.limit), options.out)
    _require_same_settings(
        options.out, {"predictions": mode.predictions, "reference": mode.reference, "seal": _seal(options.cases)}
    )
    missing = todo.find_missing()
    failed = _diagnose(missing, todo, mode, options.jobs)
    print(f"{options.out}: {len(todo.cases) - len(failed)} of {len(todo.cases)} cases diagnosed")
    for case, reason in failed:
        terminal.print_warning(f"case {case}: {reason}")
    if failed and len(failed) == len(todo.cases):
        raise CesError(f"{options.cases}: none of the cases could be diagnosed, for the reasons above")
    return 0


def _diagnose(missing: Sequence[Path], todo: CaseFolders, mode: Mode, processes: int) -> list[tuple[str, str]]:
    """Diagnose the missing cases and return those that failed, with the reason."""
    failed = []
    with JobsProgress(len(todo.cases), len(todo.cases) - len(missing), "cases") as progress:
        tasks = [(case, todo.results / case.name, mode) for case in missing]
        for row in run_in_processes(diagnose_case, tasks, processes, threads=1):
            progress.count(_describe_row(row), failed=row["status"] != "done")
            if row["status"] != "done":
                failed.append((row["case"], row["reason"]))
    return sorted(failed)


def _cases(folder: Path, limit: int | None) -> tuple[Path, ...]:
    found = sorted(path.parent for path in folder.glob("cases/*/case.json"))
    if not found:
        raise CesError(f"{folder}: holds no cases/NNNN/case.json; expected what 'ces blind make' wrote")
    return tuple(found[:limit])


def _seal(folder: Path) -> str:
    """Return the published hash, by which results and cases are known to belong together."""
    path = folder / "cases" / "seal.sha256"
    return path.read_text(encoding="utf-8").strip() if path.is_file() else ""


def _require_same_settings(results: Path, settings: dict[str, Any]) -> None:
    """Write the run's settings beside the results; raises CesError if there are results of other settings."""
    path = results / SETTINGS
    if path.is_file() and json.loads(path.read_text(encoding="utf-8")) != settings:
        raise CesError(f"{results}: holds results of other cases or options; choose another folder for --out")
    results.mkdir(parents=True, exist_ok=True)
    write_atomically(path, json.dumps(settings) + "\n")


def _is_done(row: Path) -> bool:
    return row.is_file() and json.loads(row.read_text(encoding="utf-8"))["status"] == "done"


def _describe_row(row: dict[str, Any]) -> str:
    return f"case {row['case']}: {row['summary'] if row['status'] == 'done' else row['reason']}, {row['seconds']:.1f} s"
