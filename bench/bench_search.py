"""Speed of the parts of a search, compared with the peers on the same data in the same run.

Usage: python bench/bench_search.py [--seconds S]. Trials of candidates (30,000 samples to fit, 30,000 to simulate, at
most 12 terms), free run, iteration of the simulation-error fit. Medians of the CPU time of interleaved repeats; threads
by wall time, beside what the machine gives to threads that share nothing. A peer that is not installed is skipped: pip
install '.[bench]'.
"""

from __future__ import annotations

import argparse
import statistics
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import blas_one_thread  # noqa: F401 - before NumPy
import identification_peers as peers
import numpy as np
from damper_set import model_of, series
from identification_peers import FED
from measurement import free_cores, is_installed, print_note, print_table, time_call, time_interleaved, verdict

from ces_identify.polynomial.candidates import load_rules
from ces_identify.polynomial.gauss_newton import FreeRunFit, fit_free_run
from ces_identify.polynomial.problem import Problem, assemble_problem
from ces_identify.polynomial.search_limits import RANDOM, Limits, SearchResult
from ces_identify.polynomial.selection import search
from ces_identify.simulations.simulate import simulate_series

TERMS, TICKS = 12, 30_000
ENDLESS = 1_000_000  # rounds: a start ends with its time
THREADS, TURNS = 4, 3
REPEATS, SLOW_REPEATS = 15, 3
FEW, MORE = 1, 3  # iterations of a fit; the difference gives the time of one
PEER_FEW, PEER_MORE = 2, 5
AWAY = 0.1  # relative spread of the initial coefficients of a fit


Row = tuple[str, str, str, str, str, str]


def split_problem() -> Problem:
    """Fits on 30,000 ticks of one recording (the estimation part of 45 s), evaluates on another of 30 s."""
    candidates = load_rules(None).at_rate(1000.0).candidates()
    fitted, evaluated = assemble_problem([series(1, 45.0)], candidates), assemble_problem([series(2)], candidates)
    return replace(evaluated, gram=fitted.gram, selection=evaluated.everything)


def trials(problem: Problem, threads: int, seconds: float) -> tuple[float, float, SearchResult]:
    """Run one start per thread; return trials per second and per CPU second, and the largest model."""
    limits = Limits(TERMS, seconds, starts=threads, threads=threads, rounds=ENDLESS, method=RANDOM)
    results, spent = time_call(lambda: search(problem, limits))
    total = sum(f.trials for f in results)
    return total / spent.wall, total / spent.cpu, max(results, key=lambda f: len(f.chosen))


def trial_rows(problem: Problem, seconds: float) -> tuple[list[Row], SearchResult]:
    """Return rows of trials per second, alone and in threads, and a model of TERMS terms."""
    trials(problem, 1, 1.0)  # compiles
    rates, scalings, machine = [], [], []
    for _ in range(TURNS):
        alone, core, _ = trials(problem, 1, seconds)
        together, _, found = trials(problem, THREADS, seconds)
        rates.append(core)
        scalings.append(together / alone)
        machine.append(free_cores(THREADS))
    rate, scaling, given = map(statistics.median, (rates, scalings, machine))
    peer = peer_trials() if is_installed("sysidentpy") else None
    what = f"candidates tried a CPU second, up to {TERMS} terms"
    beside = f"a hash without locks {given:.2f}"
    beside_peer = _compare("SysIdentPy MetaMSS", peer, rate)
    first = (what, f"{rate:,.0f}", *beside_peer, "at least 2,000", verdict(rate, 2000.0, True))
    second = (f"{THREADS} threads, times as many as one", f"{scaling:.2f}", beside, f"{scaling / given:.2f}")
    return [first, (*second, "at least 3", verdict(scaling, 3.0, True))], found


def peer_trials() -> float:
    """Return SysIdentPy's trials of a candidate a second."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        trial = peers.metamss_trial(FED.columns(1), FED.columns(2))
        return 1.0 / time_interleaved({"trial": trial}, SLOW_REPEATS)["trial"]


def _compare(peer: str, theirs: float | None, ours: float, faster_is_more: bool = True) -> tuple[str, str]:
    """Return the peer's figure and the ratio by which we are faster."""
    if theirs is None:
        return "", ""
    ratio = ours / theirs if faster_is_more else theirs / ours
    return f"{peer} {theirs:,.3g}", f"{ratio:,.0f}"


def free_run_rows(problem: Problem, found: SearchResult) -> list[Row]:
    """Return rows of the free run, in ns a sample and term."""
    model, test = model_of(problem, found), series(2)
    terms = len(found.chosen)
    works: dict[str, Callable[[], object]] = {
        "ours": lambda: problem.selection_cost(found.chosen, found.coefficients),
        "whole": lambda: simulate_series(model, test),
    }
    slow: dict[str, Callable[[], object]] = {}
    data = FED.columns(1)
    if is_installed("sysidentpy"):
        slow["SysIdentPy"] = partial(peers.frols(data, data).simulate, data)
    if is_installed("fastcan"):
        slow["fastcan"] = partial(peers.fastcan_one_step(data, data).simulate, data)
    times = {k: 1e9 * t / TICKS / terms for k, t in time_interleaved(works, REPEATS).items()}
    times |= {k: 1e9 * t / TICKS / TERMS for k, t in time_interleaved(slow, SLOW_REPEATS).items()}
    beside = "; ".join(f"{name} {times[name]:,.0f}" for name in slow)
    ratio = "; ".join(f"{times[name] / times['ours']:,.0f}" for name in slow)
    what = f"free run with its cost, {terms} terms, ns a sample and term"
    first = (what, f"{times['ours']:.2f}", beside, ratio, "at most 2", verdict(times["ours"], 2.0))
    return [first, ("a model on a prepared series, powers included, the same", f"{times['whole']:.2f}", "", "", "", "")]


def fit_rows(problem: Problem, found: SearchResult) -> list[Row]:
    """Return the row of an iteration of the simulation-error fit."""
    dice = np.random.default_rng(1)
    start = found.coefficients * (1.0 + AWAY * dice.standard_normal(len(found.coefficients)))

    def fit(iterations: int) -> FreeRunFit:
        return fit_free_run(problem, found.chosen, start, problem.everything, iterations)

    if not fit(MORE).error < fit(MORE - 1).error < fit(FEW).error:
        print_note("the simulation-error fit converged early: its iterations cannot be timed by their difference")
    times = time_interleaved({"few": partial(fit, FEW), "more": partial(fit, MORE)}, REPEATS)
    ours = 1e3 * (times["more"] - times["few"]) / (MORE - FEW)
    theirs = peer_iteration() if is_installed("fastcan") else None
    what = f"iteration of the simulation-error fit, {len(start)} terms, {TICKS:,} samples, ms"
    cells = (what, f"{ours:.2f}", *_compare("fastcan", theirs, ours, False), "at most 5", verdict(ours, 5.0))
    return [cells]


def peer_iteration() -> float:
    """Return fastcan's time for a step of least squares on the free run [ms]."""
    data = FED.columns(1)
    model = peers.fastcan_model(data)

    def fit(steps: int) -> object:
        return model.fit(data.inputs, data.force, coef_init="one_step_ahead", max_nfev=steps)

    works = {"few": partial(fit, PEER_FEW), "more": partial(fit, PEER_MORE)}
    times = time_interleaved(works, 1)
    return 1e3 * (times["more"] - times["few"]) / (PEER_MORE - PEER_FEW)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=4.0, help="of each of the six searches, default 4")
    options = parser.parse_args()
    problem = split_problem()
    rows, found = trial_rows(problem, options.seconds)
    rows += free_run_rows(problem, found) + fit_rows(problem, found)
    print_table(("what", "ours", "peer", "times as fast", "target", ""), rows)


if __name__ == "__main__":
    main()
