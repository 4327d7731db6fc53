"""Fits of tools to cases, each in a process of its own, and their outcomes, which are kept in files."""

from __future__ import annotations

import json
import math
import multiprocessing
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path

from bench import blas_one_thread  # noqa: F401 - before NumPy
from bench.measured.cases import CASES
from bench.measured.ticks import prepare_case
from bench.measured.tools import fit_tool
from bench.measurement import print_note, time_call

PATIENCE_S = 7200.0  # of wall time, after which a fit is stopped
NEVER = 1000.0  # [%] J beyond which a run is shown as divergent


@dataclass(frozen=True)
class FitOutcome:
    """Mean J [%] on the tests, what the tool chose, CPU and wall time [s]; or why there is none."""

    cost: float = math.inf
    chosen: str = ""
    cpu_s: float = 0.0
    wall_s: float = 0.0
    failed: str = ""


@dataclass(frozen=True)
class FitJob:
    """A fit of a tool to a case, and where its outcome is kept."""

    case: str
    tool: str
    store: Path

    @property
    def path(self) -> Path:
        return self.store / f"{self.case}_{self.tool.replace(' ', '_').replace(',', '')}.json"

    def write(self, outcome: FitOutcome) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_text(json.dumps(asdict(outcome)), encoding="utf-8")


def fit_and_store(job: FitJob) -> None:
    """Do the job in this process."""
    warnings.simplefilter("ignore")
    try:
        case = prepare_case(CASES[job.case]())
        (simulate, chosen), spent = time_call(lambda: fit_tool(job.tool, case))
        job.write(FitOutcome(case.test_cost(simulate), chosen, round(spent.cpu, 1), round(spent.wall, 1)))
    except Exception as error:  # a tool may fail in any way; the table says so
        job.write(FitOutcome(failed=f"{type(error).__name__}: {error}"))


def run_job(job: FitJob) -> FitOutcome:
    """Return the kept outcome, or that of a new process, which is stopped after PATIENCE_S."""
    if not job.path.exists():
        child = multiprocessing.get_context("spawn").Process(target=fit_and_store, args=(job,))
        child.start()
        child.join(PATIENCE_S)
        if child.is_alive():
            child.kill()
            child.join()
        if not job.path.exists():
            job.write(FitOutcome(failed=f"ended with code {child.exitcode}"))
    outcome = FitOutcome(**json.loads(job.path.read_text("utf-8")))
    shown = outcome.failed or f"{show_cost(outcome.cost)} {outcome.chosen} ({outcome.cpu_s:.0f} CPU s)"
    print_note(f"{job.case}, {job.tool}: {shown}")
    return outcome


def show_cost(cost: float) -> str:
    return f"{cost:.2f}" if cost < NEVER else "diverges"
