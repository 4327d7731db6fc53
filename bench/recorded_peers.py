"""This project's structures and other tools on recordings: free-run J [%], parameters and CPU time, in one table.

    CES_DATA=FOLDER python bench/recorded_peers.py [--cases rig dyke utfsm] [--time S] ...

Every fit runs in a process of its own. Tools with several settings (columns, number of terms, method) are shown with
the one whose free run is best on blocks of the training data left out of its fit; its CPU time is that of all
settings. Test data decide nothing. A tool or data set that is missing is skipped. Finished fits are kept in
out/recorded_peers: a rerun continues, `--again` starts afresh.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import shutil
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import blas_one_thread  # noqa: F401 - before NumPy
import identification_peers as peers
from bench_peers import count_parameters
from measurement import is_installed, print_note, print_table, time_call
from recorded_cases import (
    CASES,
    FUZZY,
    FUZZY_PREPARED,
    MEASURED,
    PLAIN,
    PREPARED,
    ROOT,
    RecordedCase,
    RecordedFit,
    data_folder,
    fit_peer,
    is_present,
    mean_cost,
    metamss,
)

from ces_data.arrays import F
from ces_identify.polynomial.search_limits import Limits
from ces_identify.prepare.series import Series
from ces_identify.simulations.simulate import simulate_series
from ces_identify.structures import KITS
from ces_identify.structures.auto import AUTO, BestStructure
from ces_identify.structures.kit import IdentifyOptions

STORE = ROOT / "out" / "recorded_peers"
PEER_S, OURS_S = 120.0, 40.0
WARM_S, WARM_SHARE = 2.0, 0.2  # time and share of the data of a fit that compiles
MARGIN_S, SLACK = 90.0, 1.5  # a process may take this much more than its limit, for reading data, tests and a last step
OURS = ("polynomial", "sigmoid", "relaxation", "chambers", AUTO)
NEVER = 1000.0  # [%] J beyond which a run is shown as divergent

FitTool = Callable[[RecordedCase, float], RecordedFit]


@dataclass(frozen=True)
class Tool:
    """A column of the table: its fits by setting, the package it needs, and which time limit it has."""

    fits: Mapping[str, FitTool]
    package: str = ""
    limit: str = "peer"


@dataclass(frozen=True)
class ToolOutcome:
    """J [%] by row and on the selection blocks, parameters, CPU time [s], or why there is none; what a tool chose."""

    costs: Mapping[str, float]
    selection_cost: float
    parameters: int
    cpu_s: float
    failed: str = ""
    chosen: str = ""


@dataclass(frozen=True)
class FitJob:
    """One fit: data set, tool, setting, time limit [s]."""

    case: str
    tool: str
    setting: str
    seconds: float

    @property
    def path(self) -> Path:
        words = f"{self.case} {self.tool} {self.setting} {self.seconds:g}"
        return STORE / ("".join(c if c.isalnum() else "_" for c in words) + ".json")


def fit_ours(structure: str, case: RecordedCase, seconds: float) -> RecordedFit:
    """Identify with the defaults of `ces identify` for a structure; the band, a further fit, is left out."""
    sizes = {size.name: size.default for kit in KITS.values() for size in kit.sizes}
    fitter = BestStructure(sizes) if structure == AUTO else KITS[structure].fitter(sizes)
    options = IdentifyOptions(limits=Limits(time=seconds, threads=1), band=False)
    fitted = fitter(case.training, case.sampling, options, lambda result: None)
    model = fitted.model

    def simulate(series: Series) -> F:
        return simulate_series(model, series).force

    parameters = int(fitted.how["parameters"]) if "parameters" in fitted.how else count_parameters(model)
    chosen = str(fitted.how["structure"]) if structure == AUTO else ""
    return RecordedFit(simulate, parameters, float(fitted.results[0].cost), chosen)


def peer_tools() -> dict[str, Tool]:
    """Return the tools other than ours, installed or not."""
    frols25, one_step25 = partial(peers.frols, terms=25), partial(peers.fastcan_one_step, terms=25)
    fits = {
        "SysIdentPy": {
            "FROLS, 12 terms": partial(fit_peer, peers.frols, PLAIN),
            "FROLS, 12 terms, prepared": partial(fit_peer, peers.frols, PREPARED),
            "FROLS, 25 terms, prepared": partial(fit_peer, frols25, PREPARED),
            "FROLS, 25 terms, no past force, prepared": partial(fit_peer, partial(frols25, past_force=False), PREPARED),
            "MetaMSS, prepared": partial(fit_peer, metamss, PREPARED),
            "MetaMSS, degree 2, prepared": partial(fit_peer, partial(metamss, degree=2), PREPARED),
        },
        "fastcan": {
            "one-step, 12 terms": partial(fit_peer, peers.fastcan_one_step, PLAIN),
            "one-step, 12 terms, prepared": partial(fit_peer, peers.fastcan_one_step, PREPARED),
            "one-step, 25 terms, prepared": partial(fit_peer, one_step25, PREPARED),
            "one-step, 25 terms, degree 2, prepared": partial(fit_peer, partial(one_step25, degree=2), PREPARED),
            "free run, 12 terms, prepared": partial(fit_peer, peers.fastcan_free_run, PREPARED),
            "free run, 12 terms, degree 2, prepared": partial(
                fit_peer, partial(peers.fastcan_free_run, degree=2), PREPARED
            ),
        },
        "anfis-toolbox": {
            "27 rules": partial(fit_peer, peers.anfis_toolbox, FUZZY),
            "27 rules, prepared": partial(fit_peer, peers.anfis_toolbox, FUZZY_PREPARED),
        },
    }
    return {name: Tool(settings, name.lower()) for name, settings in fits.items()}


def all_tools() -> dict[str, Tool]:
    """Return the columns of the table in their order."""
    ours = {name: Tool({"": partial(fit_ours, name)}, limit="ours") for name in OURS}
    return {f"**{name}**": tool for name, tool in ours.items()} | peer_tools()


def plan_jobs(cases: Sequence[str], tools: Mapping[str, Tool], limits: Mapping[str, float]) -> list[FitJob]:
    """Return all fits of these data sets and tools."""
    return [
        FitJob(case, name, setting, limits[tool.limit])
        for case in cases
        for name, tool in tools.items()
        for setting in tool.fits
    ]


def fit_and_judge(job: FitJob, case: RecordedCase, fit: FitTool) -> ToolOutcome:
    """Fit, and run freely on the test data."""
    fitted, spent = time_call(lambda: fit(case, job.seconds))
    costs = {row: mean_cost(series, fitted.simulate) for row, series in case.tests.items()}
    return ToolOutcome(costs, fitted.selection_cost, fitted.parameters, spent.cpu, chosen=fitted.chosen)


def run_in_child(job: FitJob) -> None:
    """Do the job in this process and store its outcome."""
    warnings.simplefilter("ignore")
    case, tool = CASES[job.case](), all_tools()[job.tool]
    fit = tool.fits[job.setting]
    if tool.limit == "ours":
        fit(replace(case, training=[one.part(0.0, WARM_SHARE) for one in case.training]), WARM_S)
    try:
        outcome = fit_and_judge(job, case, fit)
    except Exception as error:  # a tool may fail in any way; the table says so
        outcome = ToolOutcome({}, math.inf, 0, 0.0, f"{type(error).__name__}: {error}")
    store(job, outcome)


def store(job: FitJob, outcome: ToolOutcome) -> None:
    job.path.parent.mkdir(parents=True, exist_ok=True)
    job.path.write_text(json.dumps(asdict(outcome)), encoding="utf-8")


def run_job(job: FitJob) -> ToolOutcome:
    """Return the stored outcome, or that of a new process, which is stopped when it takes far too long."""
    if not job.path.exists():
        child = multiprocessing.get_context("spawn").Process(target=run_in_child, args=(job,))
        child.start()
        patience = MARGIN_S + SLACK * job.seconds
        child.join(patience)
        if child.is_alive():
            child.kill()
            child.join()
            store(job, ToolOutcome({}, math.inf, 0, 0.0, f"stopped after {patience:g} s"))
        elif not job.path.exists():
            store(job, ToolOutcome({}, math.inf, 0, 0.0, f"ended with code {child.exitcode}"))
    outcome = ToolOutcome(**json.loads(job.path.read_text(encoding="utf-8")))
    shown = outcome.failed or ", ".join(f"{row} {show_cost(j)}" for row, j in outcome.costs.items())
    print_note(f"{job.case}, {job.tool} {job.setting}: {shown} ({outcome.cpu_s:.0f} CPU s)")
    return outcome


def show_cost(j: float) -> str:
    return f"{j:.2f}" if j < NEVER else "diverges"


def merge(outcomes: Mapping[str, ToolOutcome]) -> tuple[str, ToolOutcome]:
    """Return the setting with the best free run on the selection blocks and its outcome, with the CPU time of all."""
    best = min(outcomes, key=lambda setting: outcomes[setting].selection_cost)
    return best, replace(outcomes[best], cpu_s=sum(one.cpu_s for one in outcomes.values()))


def format_rows(outcomes: Mapping[FitJob, ToolOutcome]) -> list[tuple[str, ...]]:
    """Return the heading and a line for each tool with its J on each row of a data set, the best of each in bold."""
    tools: dict[str, dict[str, dict[str, ToolOutcome]]] = {}
    for job, outcome in outcomes.items():
        tools.setdefault(job.tool, {}).setdefault(job.case, {})[job.setting] = outcome
    merged = {tool: [merge(settings)[1] for settings in cases.values()] for tool, cases in tools.items()}
    rows = list(dict.fromkeys(row for ones in merged.values() for one in ones for row in one.costs))
    least = {
        row: show_cost(min(one.costs.get(row, math.inf) for ones in merged.values() for one in ones)) for row in rows
    }
    lines = [("tool", *rows, "parameters", "CPU s")]
    for tool, ones in merged.items():
        cells = [next((_format_cell(one, row, least[row]) for one in ones if row in one.costs), "-") for row in rows]
        sizes = [one.parameters for one in ones if one.parameters]
        lines.append((tool, *cells, _format_range(sizes), _format_range([round(one.cpu_s) for one in ones])))
    return lines


def _format_cell(one: ToolOutcome, row: str, least: str) -> str:
    cost = show_cost(one.costs[row])
    return (f"**{cost}**" if cost == least else cost) + (f" {one.chosen}" if one.chosen else "")


def _format_range(numbers: Sequence[int]) -> str:
    """Return the smallest and the largest number as text."""
    return " to ".join(str(n) for n in sorted({min(numbers), max(numbers)})) if numbers else ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", choices=tuple(CASES), default=tuple(CASES), help="data sets")
    parser.add_argument("--tools", nargs="+", metavar="WORD", default=[""], help="tools whose name has one of these")
    parser.add_argument("--time", type=float, default=OURS_S, metavar="S", help="limit of each fit of ours [s]")
    parser.add_argument("--peer-time", type=float, default=PEER_S, metavar="S", help="limit of each peer's fit [s]")
    parser.add_argument("--processes", type=int, default=1, metavar="N", help="fits at the same time")
    parser.add_argument("--again", action="store_true", help="forget finished fits")
    options = parser.parse_args()
    if options.again:
        shutil.rmtree(STORE, ignore_errors=True)
    limits = {"ours": options.time, "peer": options.peer_time}
    jobs = plan_jobs(present_cases(options.cases), wanted_tools(options.tools), limits)
    with ThreadPoolExecutor(options.processes) as pool:
        outcomes = dict(zip(jobs, pool.map(run_job, jobs), strict=True))
    header, *rows = format_rows(outcomes)
    print_table(header, rows)


def present_cases(names: Sequence[str]) -> list[str]:
    """Return the data sets whose files are there, and say which are not."""
    for name in names:
        if not is_present(name):
            print_note(f"{name}: {MEASURED[name]} is not in {data_folder()}: skipped (set CES_DATA)")
    return [name for name in names if is_present(name)]


def wanted_tools(words: Sequence[str]) -> dict[str, Tool]:
    """Return the installed tools whose name contains one of the words."""
    chosen = {name: tool for name, tool in all_tools().items() if any(word in name for word in words)}
    return {name: tool for name, tool in chosen.items() if not tool.package or is_installed(tool.package)}


if __name__ == "__main__":
    main()
