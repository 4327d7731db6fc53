"""This project's structures and other tools on recordings: free-run J [%], parameters and CPU time, in one table.

    CES_DATA=FOLDER python bench/recorded_peers.py [--cases rig dyke utfsm utfsm-sines] [--tools WORD...] ...

Every fit runs in a process of its own and is counted in work, not in time. Tools with several settings (columns, size,
method) are shown with the one whose free run is best on blocks of the training data left out of its fit; its CPU time
is that of all settings. Test data decide nothing. A tool or data set that is missing is skipped. Finished fits are kept
in out/recorded_peers: a rerun continues, `--again` starts afresh.
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
from measurement import is_installed, print_note, print_table, time_call
from recorded_cases import CASES as WHOLE_CASES
from recorded_cases import (
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
    read_measured,
)

from ces_data.arrays import F
from ces_data.recording import Recording
from ces_identify.polynomial.search_limits import Limits
from ces_identify.prepare.sampling import choose_sampling
from ces_identify.prepare.series import Series, prepare
from ces_identify.simulations.simulate import simulate_series
from ces_identify.structures import KITS
from ces_identify.structures.auto import AUTO, BestStructure
from ces_identify.structures.kit import IdentifyOptions

STORE = ROOT / "out" / "recorded_peers"
PATIENCE_S = 3600.0  # of wall time, after which a fit is stopped
WARM_S = 2.0  # of a fit that compiles
OURS = ("polynomial", "sigmoid", "hydraulic", "recurrent", AUTO)
SINES = ("10mm2Hz", "5mm4Hz")
NETWORKS: dict[str, dict[str, dict[str, float]]] = {
    "GRU": {"32 units": {}},
    "lagged MLP": {"lags to 25 ms": {"reach_s": 0.025}, "lags to 100 ms": {"reach_s": 0.1}},
    "R2DN": {"24 states": {}},
}
NEVER = 1000.0  # [%] J beyond which a run is shown as divergent

FitTool = Callable[[RecordedCase, float], RecordedFit]


@dataclass(frozen=True)
class Tool:
    """A line of the table: its fits by setting, and the package it needs; ours need none."""

    fits: Mapping[str, FitTool]
    package: str = ""


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
    """One fit: data set, tool, setting."""

    case: str
    tool: str
    setting: str

    @property
    def path(self) -> Path:
        words = f"{self.case} {self.tool} {self.setting}"
        return STORE / ("".join(c if c.isalnum() else "_" for c in words) + ".json")


def sines_case() -> RecordedCase:
    """Return UTFSM's sines at three held currents for training, those at the two between them for tests."""

    def load(*currents: str) -> list[Recording]:
        names = [f"sine_{sine}_{current}A.csv" for sine in SINES for current in currents]
        return [read_measured(data_folder() / "utfsm_mr" / name) for name in names]

    training, tests = load("0.00", "0.50", "1.00"), load("0.25", "0.75")
    sampling = choose_sampling(training)
    rows = {"UTFSM sines, other currents": [prepare(one, sampling) for one in tests]}
    return RecordedCase(sampling, [prepare(one, sampling) for one in training], rows)


CASES: dict[str, Callable[[], RecordedCase]] = {**WHOLE_CASES, "utfsm-sines": sines_case}  # data set - what of it


def fit_ours(structure: str, case: RecordedCase, seconds: float) -> RecordedFit:
    """Identify with the defaults of `ces identify` for a structure; the band, a further fit, is left out."""
    sizes = {size.name: size.default for kit in KITS.values() for size in kit.sizes}
    fitter = BestStructure(sizes) if structure == AUTO else KITS[structure].fitter(sizes)
    options = IdentifyOptions(limits=Limits(time=seconds, threads=1), band=False)
    fitted = fitter(case.training, case.sampling, options, lambda result: None)
    model = fitted.model

    def simulate(series: Series) -> F:
        return simulate_series(model, series).force

    parameters = int(fitted.how["parameters"]) if "parameters" in fitted.how else len(model.body.terms)
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
    }
    tools = {name: Tool(settings, name.lower()) for name, settings in fits.items()}
    trees = {f"lags to {lags[-1]} ticks": partial(peers.boosted_trees, lags=lags) for lags in peers.TREE_LAGS}
    tools["boosted trees"] = Tool({n: partial(fit_peer, fit, PREPARED) for n, fit in trees.items()}, "scikit-learn")
    for name, settings in NETWORKS.items():
        tools[name] = Tool({how: partial(fit_network, name, size) for how, size in settings.items()}, "torch")
    return tools


def fit_network(name: str, size: Mapping[str, float], case: RecordedCase, seconds: float) -> RecordedFit:
    """Train a network, of small ones three; PyTorch is loaded in the process of the fit only."""
    import network_peers

    make = partial(network_peers.NETWORKS[name], **size)
    return network_peers.fit_network(make, case, seconds, members=3 if name == "lagged MLP" else 1)


def all_tools() -> dict[str, Tool]:
    """Return the lines of the table in their order."""
    ours = {name: Tool({"": partial(fit_ours, name)}) for name in OURS}
    return {f"**{name}**": tool for name, tool in ours.items()} | peer_tools()


def fit_and_judge(case: RecordedCase, fit: FitTool) -> ToolOutcome:
    """Fit, and run freely on the test data."""
    fitted, spent = time_call(lambda: fit(case, math.inf))
    costs = {row: mean_cost(series, fitted.simulate) for row, series in case.tests.items()}
    return ToolOutcome(costs, fitted.selection_cost, fitted.parameters, spent.cpu, chosen=fitted.chosen)


def run_in_child(job: FitJob) -> None:
    """Do the job in this process and store its outcome."""
    warnings.simplefilter("ignore")
    case, tool = CASES[job.case](), all_tools()[job.tool]
    fit = tool.fits[job.setting]
    try:
        if not tool.package:
            fit(case, WARM_S)
        outcome = fit_and_judge(case, fit)
    except Exception as error:  # a tool may fail in any way; the table says so
        outcome = ToolOutcome({}, math.inf, 0, 0.0, f"{type(error).__name__}: {error}")
    store(job, outcome)


def store(job: FitJob, outcome: ToolOutcome) -> None:
    job.path.parent.mkdir(parents=True, exist_ok=True)
    job.path.write_text(json.dumps(asdict(outcome)), encoding="utf-8")


def run_job(job: FitJob, patience: float) -> ToolOutcome:
    """Return the stored outcome, or that of a new process, which is stopped after `patience` [s]."""
    if not job.path.exists():
        child = multiprocessing.get_context("spawn").Process(target=run_in_child, args=(job,))
        child.start()
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
    parser.add_argument("--patience", type=float, default=PATIENCE_S, metavar="S", help="when to stop a fit [s]")
    parser.add_argument("--processes", type=int, default=1, metavar="N", help="fits at the same time")
    parser.add_argument("--again", action="store_true", help="forget finished fits")
    options = parser.parse_args()
    if options.again:
        shutil.rmtree(STORE, ignore_errors=True)
    cases, tools = present_cases(options.cases), wanted_tools(options.tools)
    jobs = [FitJob(case, name, setting) for case in cases for name, tool in tools.items() for setting in tool.fits]
    with ThreadPoolExecutor(options.processes) as pool:
        outcomes = dict(zip(jobs, pool.map(partial(run_job, patience=options.patience), jobs), strict=True))
    header, *rows = format_rows(outcomes)
    print_table(header, rows)


def present_cases(names: Sequence[str]) -> list[str]:
    """Return the data sets whose files are there, and say which are not."""
    data_sets = {name: name.partition("-")[0] for name in names}
    for name, data_set in data_sets.items():
        if not is_present(data_set):
            print_note(f"{name}: {MEASURED[data_set]} is not in {data_folder()}: skipped (set CES_DATA)")
    return [name for name, data_set in data_sets.items() if is_present(data_set)]


def wanted_tools(words: Sequence[str]) -> dict[str, Tool]:
    """Return the installed tools whose name contains one of the words."""
    chosen = {name: tool for name, tool in all_tools().items() if any(word in name for word in words)}
    return {name: tool for name, tool in chosen.items() if not tool.package or is_installed(tool.package)}


if __name__ == "__main__":
    main()
