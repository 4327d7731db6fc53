"""Cost J and time of identification, compared with the peers on the same data in the same run.

Usage: python bench/bench_peers.py [--seeds E S T]. Three recordings of damper_set: E and S for identification, T for
evaluation by the free run's J (thesis eq. 3.5). CPU seconds are those of the identification, including its children,
after compilation. Peers receive more input columns than a user would know (`identification_peers.Feed`); this project
receives position, speed and current. A peer that is not installed is skipped: pip install '.[bench]'. Takes about ten
minutes.
"""

from __future__ import annotations

import argparse
import statistics
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import blas_one_thread  # noqa: F401 - before NumPy
import identification_peers as peers
import numpy as np
from damper_set import RATE, SAMPLING, WARM_UP, F, model_of, series
from identification_peers import FED, HELPED, POWER_FED, RAW, Columns, Feed, PeerModel
from measurement import Spent, is_installed, print_note, print_table, time_call

from ces_identify.polynomial.gauss_newton import refit_coefficients
from ces_identify.polynomial.search_limits import BOTH, GAUSS_NEWTON, RANDOM, Limits
from ces_identify.polynomial.selection import search
from ces_identify.prepare.cost import cost
from ces_identify.prepare.series import Series
from ces_identify.simulations.simulate import simulate_series
from ces_identify.structures.fuzzy import FuzzyFit, FuzzyShape, PremiseGrid
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.structures.network import NetworkFit, NetworkShape
from ces_identify.structures.polynomial import build_problem
from ces_identify.trained.training import Family, Lags, Training, build_regressors, build_training, train
from ces_observer.model import Model
from ces_observer.structures.fuzzy import Fuzzy
from ces_observer.structures.network import Network

LAGS = Lags(position_s=(0.0,))
INPUTS = "position, speed, current"
SECONDS = 60.0  # time limit of a search
QUICK_S, REPEATS = 2.0, 5  # shorter fits are repeated


@dataclass(frozen=True)
class Entry:
    """A tool, its inputs, its fit, and the evaluation of J on the test recording and of the number of terms."""

    tool: str
    inputs: str
    fit: Callable[[], object]
    judge: Callable[[object], tuple[float, int]]


@dataclass(frozen=True)
class PeerOutcome:
    """J [%] on the test recording, the number of terms or parameters, and the time of the fit."""

    entry: Entry
    cost: float
    terms: int
    spent: Spent


def peer_entries(seeds: Sequence[int]) -> list[Entry]:
    """Return the installed peers with every feed."""
    both_currents = tuple(replace(feed, current_now=True) for feed in (RAW, HELPED, FED))
    tools: list[tuple[str, str, Callable[[Columns, Columns], PeerModel], tuple[Feed, ...]]] = [
        ("sysidentpy", "SysIdentPy FROLS", peers.frols, (RAW, HELPED, FED)),
        ("sysidentpy", "SysIdentPy MetaMSS", peers.metamss, (RAW, FED)),
        ("fastcan", "fastcan NARX, one-step", peers.fastcan_one_step, both_currents),
        ("fastcan", "fastcan NARX, free run", peers.fastcan_free_run, both_currents),
        ("anfis-toolbox", "anfis-toolbox", peers.anfis_toolbox, (RAW, POWER_FED)),
    ]
    present = {package for package in dict.fromkeys(row[0] for row in tools) if is_installed(package)}
    return [
        peer_entry(tool, fit, feed, seeds)
        for package, tool, fit, feeds in tools
        if package in present
        for feed in feeds
    ]


def peer_entry(tool: str, fit: Callable[[Columns, Columns], PeerModel], feed: Feed, seeds: Sequence[int]) -> Entry:
    """Return a peer's run with one feed."""
    estimation, selection, test = (feed.columns(seed) for seed in seeds)

    def judge(fitted: object) -> tuple[float, int]:
        assert isinstance(fitted, PeerModel)
        return free_run_cost(test.force, fitted.simulate(test)), fitted.terms

    return Entry(tool, feed.name, partial(fit, estimation, selection), judge)


def our_entries(seeds: Sequence[int]) -> list[Entry]:
    """Return this project's structures and selection methods."""
    *training, test = (series(seed) for seed in seeds)

    def judge(model: object) -> tuple[float, int]:
        assert isinstance(model, Model)
        return free_run_cost(test.force, simulate_series(model, test).force), count_parameters(model)

    polynomials = [
        Entry(f"**polynomial, {method}**", INPUTS, partial(identify_polynomial, training, method), judge)
        for method in (RANDOM, GAUSS_NEWTON, BOTH)
    ]
    trained = [
        Entry("**sigmoid network**", INPUTS, partial(train_model, training, network), judge),
        Entry("**ANFIS**", INPUTS, partial(train_model, training, fuzzy), judge),
    ]
    return [*polynomials, *trained]


def identify_polynomial(
    data: Sequence[Series], method: str, max_terms: int = peers.TERMS, seconds: float = SECONDS
) -> Model:
    """Identify a polynomial like `ces identify`: a start of each kind, one thread, stable models only, refitted."""
    limits = Limits(max_terms, seconds, starts=2 if method == BOTH else 1, threads=1, method=method)
    problem = build_problem(data, IdentifyOptions(limits=limits))
    found = search(problem, limits)[0]
    return model_of(problem, replace(found, coefficients=refit_coefficients(problem, found)))


def network(data: Training) -> Family:
    shape = NetworkShape(lags=LAGS)
    return NetworkFit(data, build_regressors(data, shape.lags, RATE), shape.units, shape.decay)


def fuzzy(data: Training) -> Family:
    shape = FuzzyShape(lags=LAGS)
    grid = (
        PremiseGrid("speed", 0, shape.speeds),
        PremiseGrid("current", round(shape.current_delay_s * RATE), shape.currents),
    )
    return FuzzyFit(data, build_regressors(data, shape.lags, RATE), grid, shape.decay)


def train_model(data: Sequence[Series], family: Callable[[Training], Family], seconds: float = SECONDS) -> Model:
    """Train on the free run: one start, one thread, stable models only."""
    of = family(build_training(data))
    found = train(of, Limits(time=seconds, starts=1, threads=1))[0]
    return of.model(found.coefficients, SAMPLING)


def count_parameters(model: Model) -> int:
    """Return the number of terms of a polynomial, of parameters of a network or of neuro-fuzzy rules."""
    match model.body:
        case Network(linear=linear, units=units):
            return 1 + len(linear) + sum(2 + len(unit.slopes) for unit in units)
        case Fuzzy(premises=premises, rules=rules):
            return 3 * sum(len(premise.memberships) for premise in premises) + sum(1 + len(r.linear) for r in rules)
    return len(model.body.terms)


def free_run_cost(measured: F, simulated: F) -> float:
    """Return J [%] after the warm-up, infinite if the run diverged."""
    return cost(measured[WARM_UP:], simulated[WARM_UP:])


def run(entry: Entry) -> PeerOutcome:
    """Fit and evaluate; quick fits are repeated for the median time."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        fitted, spent = time_call(entry.fit)
        more = REPEATS - 1 if spent.wall < QUICK_S else 0
        times = [spent, *(time_call(entry.fit)[1] for _ in range(more))]
        j, terms = entry.judge(fitted)
    median = Spent(statistics.median(t.cpu for t in times), statistics.median(t.wall for t in times))
    print_note(f"{entry.tool}, {entry.inputs}: J {j:.2f}, {median.cpu:.2f} CPU s, {terms} terms")
    return PeerOutcome(entry, j, terms, median)


def warm_up(seeds: Sequence[int]) -> None:
    """Compile the kernels of the runs."""
    short = [series(seed, 6.0) for seed in seeds[:2]]
    for method in (RANDOM, GAUSS_NEWTON):
        identify_polynomial(short, method, 3, 2.0)
    for family in (network, fuzzy):
        train_model(short, family, 2.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs=3, default=(1, 2, 3), metavar=("E", "S", "T"))
    seeds = parser.parse_args().seeds
    warm_up(seeds)
    outcomes = [run(entry) for entry in our_entries(seeds) + peer_entries(seeds)]
    header = ("tool", "inputs", "J on the test %", "CPU s", "terms")
    print_table(header, [row(o) for o in outcomes], left=2)


def row(outcome: PeerOutcome) -> tuple[str, ...]:
    """Return a row of the table."""
    j = f"{outcome.cost:.2f}" if outcome.cost < 1000.0 else "diverges"
    return outcome.entry.tool, outcome.entry.inputs, j, f"{outcome.spent.cpu:.2f}", str(outcome.terms)


if __name__ == "__main__":
    main()
